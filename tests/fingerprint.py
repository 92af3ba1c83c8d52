"""What users and files see of tokt, as hashes: a pure restructuring changes none of them.

Calls the installed command line on the real mission and compares with `tests/fingerprint.json`.
Nothing of tokt is imported, so that modules can move. To see what differs, keep what is hashed
(``--keep DIR``) here and in a worktree of the version before, and compare the two folders.
"""

import argparse
import hashlib
import io
import json
import os
import platform
import re
import socket
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

CHECKOUT = Path(__file__).resolve().parents[1]
STORED = CHECKOUT / "tests" / "fingerprint.json"
_BESIDE = CHECKOUT.parent / "shared" / "mission" / "approach"
MISSION = Path(os.environ.get("TOKT_MISSION", _BESIDE)).resolve()
CALIBRATION = MISSION.parent / "calibration.yml"
LIBRARIES = ("numpy", "opencv-python-headless", "scikit-learn", "scipy", "matplotlib", "mlflow")
ANOTHER = (
    "written on another machine ({}); first write one of that version here: git worktree add "
    "../before $(git log -1 --format=%h -- tests/fingerprint.json) && make -C ../before "
    "fingerprint ARGS=--write, and compare with ARGS='--file ../before/tests/fingerprint.json'"
)

# One thread: matrix products that are shared out among threads may round in another way.
ENVIRONMENT = {name: value for name, value in os.environ.items() if name != "MLFLOW_TRACKING_URI"}
ENVIRONMENT |= {"COLUMNS": "100", "TERM": "dumb", "NO_COLOR": "1"}
ENVIRONMENT |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

# What differs between two runs of the same code. Keys stay: that a field is there is compared.
VARIES = (
    # When something was, and how long it took; the last two are of reports.
    (r'"(t|texture_s|seconds|\w+_ms(_mean|_max)?)": ?[-+.\de]+', r'"\1"'),
    (r"\d{4}-\d\d-\d\dT[\d:.]+(Z|\+00:00)", "TIME"),
    (r"(time per frame</th>).*", r"\1"),
    (r"\btokt \d+\.\d+\.\d+(\.dev\d+)?(, \d+ s)?", "tokt"),
    # Ids of runs: tokt's own and MLflow's.
    (r"run-\d{8}-\d{6}-[0-9a-f]{6}", "RUN"),
    (r"\b(m-)?[0-9a-f]{32}\b", "ID"),
    # Hashes of what holds such ids: a bundle, its manifest and its card.
    (r'"(sha256|manifest_sha256|card\.md)": ?"[0-9a-f]{64}"', r'"\1"'),
    (r"(bundle sha256) [0-9a-f]{64}", r"\1"),
    # Who made it, and with what: the code is what is compared, the rest stands under "machine".
    (r'"(who|tokt|code_version|libraries|numpy|opencv|cpu)": ?"[^"]*"', r'"\1"'),
    (r"- (code version|libraries): .*", r"- \1"),
    # Recipe and bundle hold the code's version; what else is in them is compared by itself.
    (r'((?:recipe\.json|model\.tokt)\\?": ?\\?")[0-9a-f]{64}', r"\1HASH"),
)

MODELS = {
    "lbp": "--extractor lbp --preset plain",
    "haralick": "--extractor haralick --preset plain",
    "thesis": "--extractor haralick --preset thesis",
    "best": "--preset best",
}
TEXTURE = "--source approach --log-values --policy texture"
STEREO = "--source approach --calibration calibration.yml --policy"
RENDERED = "--source rendered --calibration rendered/calibration.yml --policy"
RUNS = {
    "texture": f"{TEXTURE} --bundle best.tokt",
    "texture-lbp": f"{TEXTURE} --bundle lbp.tokt --anchor 0.1",
    "texture-thesis": f"{TEXTURE} --bundle thesis.tokt",
    "either": f"{STEREO} either --bundle best.tokt",
    "fallback": f"{STEREO} fallback --bundle best.tokt",
    "fallen-back": f"{RENDERED} fallback --bundle none.tokt",
    "disparity": f"{STEREO} disparity",
    "pushbroom": f"{STEREO} disparity --stereo pushbroom",
    "sgbm": f"{RENDERED} disparity --stereo sgbm",
}
EXPORTS = {
    "plain.csv": "--annotator anna",
    "full.csv": "--full",
    "viame.csv": "--format viame --mission-dir approach",
    "coco.json": "--format coco --mission-dir approach",
    "studio.json": "--format labelstudio --mission-dir approach",
    "patches": "--annotator anna --mission-dir approach",
}
# A name and what it stands for; text is freed of what varies before it is hashed.
Entries = Iterator[tuple[str, str | bytes]]


def digest(content: bytes) -> str:
    """Half of the SHA-256, in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()[:32]


@dataclass(frozen=True)
class Tokt:
    """The installed command line, called in `folder`, which is outside the checkout."""

    folder: Path

    def __call__(self, command: str, *codes: int) -> str:
        """What a command prints; the program ends if its exit code is not 0 or one of `codes`."""
        return self.python(["-m", "tokt", *command.split()], codes)

    def python(self, arguments: list[str], codes: tuple[int, ...] = ()) -> str:
        """The same of this Python, which does not import from the folder it is called in."""
        command = [sys.executable, "-P", *arguments]
        kept: dict[str, Any] = {"capture_output": True, "encoding": "utf-8"}
        ran = subprocess.run(command, cwd=self.folder, env=ENVIRONMENT, **kept)
        if ran.returncode not in (0, *codes):
            raise SystemExit(f"{' '.join(arguments)}: exit {ran.returncode}\n{ran.stderr}")
        return ran.stdout

    def heard(self, options: str) -> tuple[str, list[bytes]]:
        """What `tokt run` prints, and the datagrams that it sends, v1 and v2."""
        datagrams = []
        with socket.socket(type=socket.SOCK_DGRAM) as receiver, ThreadPoolExecutor(1) as pool:
            receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
            receiver.bind(("127.0.0.1", 0))
            receiver.settimeout(0.2)
            to = f"127.0.0.1:{receiver.getsockname()[1]}"
            ran = pool.submit(self, f"run {options} --udp v1@{to} --udp v2@{to} --json")
            while True:
                try:
                    datagrams.append(receiver.recv(65535))
                except TimeoutError:
                    if ran.done():
                        break
        if (sent := json.loads(ran.result())["sent"]) != len(datagrams):
            raise SystemExit(f"{len(datagrams)} of {sent} datagrams arrived: run it again")
        return ran.result(), datagrams

    def text(self, name: str) -> str:
        """A file's text, line ends as they are."""
        return (self.folder / name).read_bytes().decode()

    def files(self, name: str) -> bytes:
        """A file's bytes, or a line for each file of a folder: its path and hash."""
        if (self.folder / name).is_file():
            return (self.folder / name).read_bytes()
        paths = sorted(path for path in (self.folder / name).rglob("*") if path.is_file())
        lines = [f"{path.relative_to(self.folder)} {digest(path.read_bytes())}" for path in paths]
        return "\n".join(lines).encode()

    def neutral(self, text: str) -> str:
        """The text without this machine's folders and without what varies."""
        text = text.replace(str(self.folder), "FOLDER").replace(str(MISSION.parent), "MISSIONS")
        for pattern, instead in VARIES:
            text = re.sub(pattern, instead, text)
        return text


def helps(tokt: Tokt, command: str = "") -> Entries:
    """The help text of a command and of every command below it."""
    text = tokt(f"{command} --help")
    yield f"help/tokt{command}", text
    commands = text if "COMMAND [ARGS]" in text else ""
    for name in re.findall(r"^  ([a-z]+)  ", commands, re.MULTILINE):
        yield from helps(tokt, f"{command} {name}")


def models(tokt: Tokt) -> Entries:
    """Dataset, training, bundles, and what else is told of the models."""
    labelled = "--mission approach --labels approach/labels.csv --json"
    yield "dataset/build", tokt(f"dataset build tower {labelled}")
    yield "dataset/show", tokt("dataset show tower --json")
    for name, options in MODELS.items():
        train = f"train tower --name {name} {options} --folds 2 --jobs 1 --json"
        yield f"train/{name}", tokt(train)
        tokt(f"export {name} -o {name}.tokt")
        with zipfile.ZipFile(tokt.folder / f"{name}.tokt") as bundle:
            yield f"bundle/{name}/members", "\n".join(bundle.namelist())
            for member in bundle.namelist():
                yield from _member(f"bundle/{name}/{member}", bundle.read(member))
    yield "models/list", tokt("models list --json")
    yield "models/evaluate", tokt(f"evaluate lbp {labelled} --frames 132-246")
    yield "models/audit", tokt("labels audit lbp -o odd.csv") + tokt.text("odd.csv")
    yield "compare/json", tokt("compare lbp haralick -o compared.html --json")
    yield "compare/html", tokt.text("compared.html")
    for command in ("deploy lbp.tokt", "deploy best.tokt", "rollback"):
        tokt(f"{command} store --reason fingerprint")
    yield "store/json", tokt("store store --json")
    yield "store/history", tokt.text("store/history.jsonl")


def _member(name: str, content: bytes) -> Entries:
    """A bundle's member: its text, or its arrays one by one."""
    if not name.endswith(".npz"):
        yield name, content.decode()
        return
    for key, array in np.load(io.BytesIO(content), allow_pickle=False).items():
        yield f"{name}/{key}", f"{array.dtype.str} {array.shape}\n".encode() + array.tobytes()


def stereo(tokt: Tokt) -> Entries:
    """A rendered mission, and what two cameras measure in it and in the real one."""
    yield "simulate/json", tokt("simulate rendered --frames 12 --width 680 --json")
    yield "simulate/files", tokt.files("rendered")
    fit = "calibrate rendered --fit all -o rig.yml --report rig.html --json"
    yield "calibrate/fit", tokt(fit)
    yield "calibrate/files", tokt.text("rig.yml") + tokt.text("rig.html")
    real = "approach --calibration calibration.yml --json --frames"
    yield "calibrate/check", tokt(f"calibrate --check {real} 170-190")
    depth = f"depth {real} 160-200 --rate 10 --out depth --ply tower.ply"
    yield "depth/json", tokt(depth)
    yield "depth/files", tokt.files("depth")
    yield "depth/ply", tokt.files("tower.ply")


def runs(tokt: Tokt) -> Entries:
    """Datagrams and logs of the runtime, and one log judged again."""
    for name, options in RUNS.items():
        summary, sent = tokt.heard(f"{options} --log {name}.jsonl")
        yield f"run/{name}/v1", b"\n".join(line for line in sent if line[:1] != b"{")
        yield f"run/{name}/v2", b"\n".join(line for line in sent if line[:1] == b"{").decode()
        yield f"run/{name}/log", tokt.text(f"{name}.jsonl")
        yield f"run/{name}/events", tokt.text(f"{name}.events.jsonl")
        yield f"run/{name}/summary", summary
    yield "replay/same", tokt("replay either.jsonl --json")
    yield "replay/other", tokt("replay either.jsonl --bundle lbp.tokt --json", 1)


def labels(tokt: Tokt) -> Entries:
    """Labels of two people in every format, and what comes of each when it is read again."""
    # With times of their own: exports hold none of today. All frames' pictures take a minute.
    columns = "mission,camera,frame,row,col,label,annotator,time,grid,source,model_version"
    for name, file in (("anna", "labels.csv"), ("ben", "labels_second_annotator.csv")):
        said = f",{name},2016-04-20T10:00:00Z,10x10@360,human,\n"
        lines = (MISSION / file).read_text("utf-8").splitlines()[1:]
        some = [line + said for line in lines if int(line.split(",")[2]) % 13 == 0]
        (tokt.folder / f"{name}.csv").write_text(f"{columns}\n{''.join(some)}", "utf-8")
        yield f"labels/import-{name}", tokt(f"labels import {name}.csv --json")
    yield "labels/stats", tokt("labels stats --json")
    yield "labels/agreement", tokt("labels agreement anna ben --json")
    for file, options in EXPORTS.items():
        yield f"labels/export-{file}", tokt(f"labels export {file} {options} --json")
        yield f"labels/{file}", tokt.files(file)
        yield f"labels/import-{file}", tokt(f"labels import {file} --workspace of-{file} --json")
        tokt(f"labels export again-{file}.csv --full --workspace of-{file}")
        yield f"labels/again-{file}", tokt.text(f"again-{file}.csv")


def machine(tokt: Tokt) -> dict[str, str]:
    """What hashes depend on besides the code."""
    cpuinfo = Path("/proc/cpuinfo")
    told = re.search(r"model name\s*: (.+)", cpuinfo.read_text()) if cpuinfo.is_file() else None
    findings = json.loads(tokt("doctor --json", 1))["findings"]
    kernels = next(finding for finding in findings if finding["name"] == "kernels")
    return {
        "processor": told[1] if told else platform.machine(),
        "python": platform.python_version(),
        **{library: version(library) for library in LIBRARIES},
        "kernels": f"{kernels['kernels']}, {kernels['detail']}",
    }


def fingerprint(tokt: Tokt, keep: Path | None) -> dict[str, str]:
    """Every entry's hash; what is hashed goes into the folder `keep`, if there is one."""
    hashes = {}
    for part in (helps, models, stereo, runs, labels):
        for name, content in part(tokt):
            data = content if isinstance(content, bytes) else tokt.neutral(content).encode()
            hashes[name] = digest(data)
            if keep:
                (keep / name).parent.mkdir(parents=True, exist_ok=True)
                (keep / name).write_bytes(data)
    return hashes


def compare(stored: dict[str, Any], found: dict[str, Any]) -> int:
    """Say which entries differ, a line each; 1 where one does, else 0."""
    there, here = stored["machine"], found["machine"]
    other = [key for key in here if there.get(key) != here[key]]
    if other:
        print(
            ANOTHER.format(", ".join(f"{key} {there.get(key)}, not {here[key]}" for key in other))
        )
    before, now = stored["entries"], found["entries"]
    differ = [name for name in before | now if before.get(name) != now.get(name)]
    for name in differ:
        print(name, "is new" if name not in before else "is gone" if name not in now else "differs")
    if not differ:
        print(f"{len(now)} entries, all as in version {stored['version']}")
    return int(bool(differ))


def main() -> int:
    """Compute the fingerprint, then store it or compare it; 1 where it differs."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--write", action="store_true", help="store this version's hashes")
    parser.add_argument("--file", type=Path, default=STORED, help="where hashes are stored")
    parser.add_argument("--keep", type=Path, help="a folder for what is hashed, mission data too")
    asked = parser.parse_args()
    if asked.keep and asked.keep.resolve().is_relative_to(CHECKOUT):
        parser.error("--keep: mission data never goes into the checkout")
    for needed in (MISSION / "labels.csv", CALIBRATION, *([] if asked.write else [asked.file])):
        if not needed.is_file():
            parser.error(f"{needed} is not there (TOKT_MISSION says where the mission is)")
    with tempfile.TemporaryDirectory() as folder:
        tokt = Tokt(Path(folder).resolve())
        (tokt.folder / "approach").symlink_to(MISSION)
        (tokt.folder / "calibration.yml").symlink_to(CALIBRATION)
        where = tokt.python(["-c", "import importlib.util as u; print(u.find_spec('tokt').origin)"])
        if not Path(where.strip()).resolve().is_relative_to(CHECKOUT):
            print(f"not of this checkout, but of {where.strip()}")
        found: dict[str, Any] = {"version": tokt("--version").split()[-1]}
        found["machine"] = machine(tokt)
        found["entries"] = fingerprint(tokt, asked.keep)
    if not asked.write:
        return compare(json.loads(asked.file.read_text("utf-8")), found)
    asked.file.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(f"{len(found['entries'])} entries of version {found['version']} written")
    return 0


if __name__ == "__main__":
    sys.exit(main())
