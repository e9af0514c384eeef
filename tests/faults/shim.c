/* A file system and a clock that fail, put between a process and the C library by LD_PRELOAD.

   FAULT_PATH    calls on files whose path holds this text are meant
   FAULT_CALL    write, fsync, rename, open or copy: what fails; look: opening to read; read
   FAULT_ERRNO   with which error
   FAULT_AFTER   how many of them succeed before
   FAULT_TIMES   how many of them fail; all for 0
   FAULT_SLOW_MS milliseconds that every read of such a file takes longer
   FAULT_CLOCK   seconds that the clock of the day goes back at every second look
*/
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

static atomic_int calls, looks;

static const char *wish(const char *name) {
  const char *value = getenv(name);
  return value ? value : "";
}

static int is_meant(const char *path) {
  const char *part = wish("FAULT_PATH");
  return *part && path && strstr(path, part) != NULL;
}

static int is_meant_fd(int fd) {
  char name[64], path[4096];
  snprintf(name, sizeof name, "/proc/self/fd/%d", fd);
  ssize_t size = readlink(name, path, sizeof path - 1);
  if (size < 0) return 0;
  path[size] = 0;
  return is_meant(path);
}

/* Whether this call is to fail; sets errno then. */
static int fails(const char *call) {
  if (strcmp(wish("FAULT_CALL"), call) != 0) return 0;
  int number = atomic_fetch_add(&calls, 1), after = atoi(wish("FAULT_AFTER"));
  int times = atoi(wish("FAULT_TIMES"));
  if (number < after || (times && number >= after + times)) return 0;
  errno = atoi(wish("FAULT_ERRNO"));
  return 1;
}

static void dawdle(int fd) {
  int slow = atoi(wish("FAULT_SLOW_MS"));
  if (slow && is_meant_fd(fd)) {
    int before = errno;
    struct timespec wait = {slow / 1000, (slow % 1000) * 1000000L};
    nanosleep(&wait, NULL);
    errno = before;
  }
}

static int cannot_read(int fd) {
  dawdle(fd);
  return strcmp(wish("FAULT_CALL"), "read") == 0 && is_meant_fd(fd) && fails("read");
}

#define REAL(type, name, ...) \
  static type (*real)(__VA_ARGS__); \
  if (!real) real = (type(*)(__VA_ARGS__))dlsym(RTLD_NEXT, name)

ssize_t write(int fd, const void *data, size_t size) {
  REAL(ssize_t, "write", int, const void *, size_t);
  if (*wish("FAULT_CALL") && is_meant_fd(fd) && fails("write")) return -1;
  return real(fd, data, size);
}

ssize_t writev(int fd, const struct iovec *pieces, int count) {
  REAL(ssize_t, "writev", int, const struct iovec *, int);
  if (*wish("FAULT_CALL") && is_meant_fd(fd) && fails("write")) return -1;
  return real(fd, pieces, count);
}

int fsync(int fd) {
  REAL(int, "fsync", int);
  if (*wish("FAULT_CALL") && is_meant_fd(fd) && fails("fsync")) return -1;
  return real(fd);
}

int rename(const char *from, const char *to) {
  REAL(int, "rename", const char *, const char *);
  if (is_meant(to) && fails("rename")) return -1;
  return real(from, to);
}

static int opened(int (*real)(const char *, int, ...), const char *path, int flags, int mode) {
  if ((flags & (O_WRONLY | O_RDWR)) && is_meant(path) && fails("open")) return -1;
  if (!(flags & (O_WRONLY | O_RDWR)) && is_meant(path) && fails("look")) return -1;
  return real(path, flags, mode);
}

#define OPENING(name)                         \
  int name(const char *path, int flags, ...) { \
    REAL(int, #name, const char *, int, ...);  \
    va_list more;                              \
    va_start(more, flags);                     \
    int mode = va_arg(more, int);              \
    va_end(more);                              \
    return opened(real, path, flags, mode);    \
  }

OPENING(open)
OPENING(open64)

/* What std::ifstream and the C library's own streams open by. */
#define STREAMING(name)                                                      \
  FILE *name(const char *path, const char *mode) {                           \
    REAL(FILE *, #name, const char *, const char *);                         \
    if (*mode == 'r' && !strchr(mode, '+') && is_meant(path) && fails("look")) return NULL; \
    return real(path, mode);                                                 \
  }

STREAMING(fopen)
STREAMING(fopen64)

ssize_t read(int fd, void *room, size_t size) {
  REAL(ssize_t, "read", int, void *, size_t);
  if (cannot_read(fd)) return -1;
  return real(fd, room, size);
}

ssize_t pread(int fd, void *room, size_t size, off_t at) {
  REAL(ssize_t, "pread", int, void *, size_t, off_t);
  if (cannot_read(fd)) return -1;
  return real(fd, room, size, at);
}

ssize_t pread64(int fd, void *room, size_t size, off64_t at) {
  REAL(ssize_t, "pread64", int, void *, size_t, off64_t);
  if (cannot_read(fd)) return -1;
  return real(fd, room, size, at);
}

ssize_t preadv(int fd, const struct iovec *rooms, int count, off_t at) {
  REAL(ssize_t, "preadv", int, const struct iovec *, int, off_t);
  if (cannot_read(fd)) return -1;
  return real(fd, rooms, count, at);
}

int clock_gettime(clockid_t id, struct timespec *now) {
  int done = (int)syscall(SYS_clock_gettime, id, now);
  int back = atoi(wish("FAULT_CLOCK"));
  if (done == 0 && back && id == CLOCK_REALTIME && atomic_fetch_add(&looks, 1) % 2)
    now->tv_sec -= back;
  return done;
}

time_t time(time_t *out) {
  struct timespec now;
  clock_gettime(CLOCK_REALTIME, &now);
  if (out) *out = now.tv_sec;
  return now.tv_sec;
}
