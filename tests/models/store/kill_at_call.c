/* Kills the process at one of its calls of the system that change a file: loaded before libc, it
   stands in for them. `kill_at_call` chooses the call, counted from there. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <sys/types.h>
#include <unistd.h>

static int left, torn;

/* `torn_write`: only writes are counted, and the one chosen is killed after half of its bytes. */
void kill_at_call(int call, int torn_write) { left = call; torn = torn_write; }

static int is_here(int write) { return write >= torn && left > 0 && --left == 0; }
static void end(void) { kill(getpid(), SIGKILL); }

#define REAL(result, name, ...) ((result (*)(__VA_ARGS__))dlsym(RTLD_NEXT, #name))
#define STAND_IN(name, types, values) \
    int name types { if (is_here(0)) end(); return ((int (*) types)dlsym(RTLD_NEXT, #name)) values; }

STAND_IN(rename, (const char *a, const char *b), (a, b))
STAND_IN(renameat, (int d, const char *a, int e, const char *b), (d, a, e, b))
STAND_IN(unlink, (const char *a), (a))
STAND_IN(unlinkat, (int d, const char *a, int flags), (d, a, flags))
STAND_IN(rmdir, (const char *a), (a))
STAND_IN(mkdir, (const char *a, mode_t mode), (a, mode))
STAND_IN(mkdirat, (int d, const char *a, mode_t mode), (d, a, mode))
STAND_IN(link, (const char *a, const char *b), (a, b))
STAND_IN(symlink, (const char *a, const char *b), (a, b))
STAND_IN(chmod, (const char *a, mode_t mode), (a, mode))
STAND_IN(fchmod, (int d, mode_t mode), (d, mode))
STAND_IN(fsync, (int d), (d))
STAND_IN(fdatasync, (int d), (d))
STAND_IN(ftruncate, (int d, off_t size), (d, size))
STAND_IN(ftruncate64, (int d, off64_t size), (d, size))
STAND_IN(truncate, (const char *a, off_t size), (a, size))
STAND_IN(truncate64, (const char *a, off64_t size), (a, size))
STAND_IN(posix_fallocate, (int d, off_t at, off_t size), (d, at, size))
STAND_IN(posix_fallocate64, (int d, off64_t at, off64_t size), (d, at, size))

ssize_t write(int d, const void *bytes, size_t size)
{
    ssize_t (*real)(int, const void *, size_t) = REAL(ssize_t, write, int, const void *, size_t);
    if (is_here(1)) {
        if (torn) real(d, bytes, size / 2);
        end();
    }
    return real(d, bytes, size);
}

ssize_t sendfile(int to, int from, off_t *at, size_t size)
{
    ssize_t (*real)(int, int, off_t *, size_t) = REAL(ssize_t, sendfile, int, int, off_t *, size_t);
    if (is_here(1)) {
        if (torn) real(to, from, at, size / 2);
        end();
    }
    return real(to, from, at, size);
}

#define CHANGES (O_CREAT | O_TRUNC)
#define OPEN(name, types, values)                                        \
    int name types                                                       \
    {                                                                    \
        mode_t mode = 0;                                                 \
        if (flags & O_CREAT) {                                           \
            va_list more;                                                \
            va_start(more, flags);                                       \
            mode = va_arg(more, mode_t);                                 \
            va_end(more);                                                \
        }                                                                \
        if ((flags & CHANGES) && is_here(0)) end();                       \
        return ((int (*) types)dlsym(RTLD_NEXT, #name)) values;          \
    }

OPEN(open, (const char *a, int flags, ...), (a, flags, mode))
OPEN(open64, (const char *a, int flags, ...), (a, flags, mode))
OPEN(openat, (int d, const char *a, int flags, ...), (d, a, flags, mode))
OPEN(openat64, (int d, const char *a, int flags, ...), (d, a, flags, mode))
