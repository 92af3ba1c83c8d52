#!/bin/sh
# Run a command in a bare Debian of another architecture or release, the checkout at /tokt there.
# Usage, as root: packaging/root.sh ARCH SUITE PACKAGES FOLDER COMMAND...
# It needs mmdebstrap, and qemu-user-static for another architecture. What it mounts ends with it.
set -eu
arch=$1 suite=$2 packages=$3 root=$4
shift 4
checkout=$(cd "$(dirname "$0")/.." && pwd)
if ! [ -d "$root" ]; then
  [ -e /proc/sys/fs/binfmt_misc/register ] ||
    mount -t binfmt_misc none /proc/sys/fs/binfmt_misc || echo "no binfmt_misc here" >&2
  if [ "$arch" != "$(dpkg --print-architecture)" ]; then update-binfmts --enable; fi
  # Mirrors may be some weeks behind an unreleased suite's date.
  mmdebstrap --quiet --variant=minbase --architectures="$arch" --include="ca-certificates,$packages" \
    --aptopt='Acquire::Check-Valid-Until "false"' "$suite" "$root"
fi
# The index behind a company's own certificate is reached from within too.
cert=${PIP_CERT:-${REQUESTS_CA_BUNDLE:-}}
export checkout root cert
# shellcheck disable=SC2016
exec unshare --mount sh -c '
  set -eu
  mkdir -p "$root/tokt"
  mount --bind "$checkout" "$root/tokt"
  mount --rbind /dev "$root/dev"
  mount -t proc none "$root/proc"
  mount -t tmpfs none "$root/run"
  cp /etc/resolv.conf "$root/run/resolv.conf"
  mount --bind "$root/run/resolv.conf" "$root/etc/resolv.conf"
  if [ -n "$cert" ]; then cp "$cert" "$root/run/cert.pem"; fi
  exec env -i HOME=/root LANG=C.UTF-8 PATH=/usr/local/bin:/usr/bin:/bin:/usr/sbin:/sbin \
    ${cert:+PIP_CERT=/run/cert.pem} chroot "$root" sh -c "cd /tokt && exec \"\$@\"" sh "$@"' sh "$@"
