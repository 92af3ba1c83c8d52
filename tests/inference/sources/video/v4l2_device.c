/* A USB camera that is not there, for LD_PRELOAD: the calls that reach a video device by a file.
 *
 * TOKT_V4L2_DEVICE   the file that stands for the device
 * TOKT_V4L2_FRAMES   a folder with MJPG, YUYV, H264, GREY: what it sends in each of these formats, each
 *                    buffer with two numbers in front: what becomes of it, and its bytes
 * TOKT_V4L2_WAIT_US  from one buffer to the next
 *
 * It has 320x240, of which each file's first are, and 640x480.
 */
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/videodev2.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

enum { WHOLE, DAMAGED, GONE, HANGS, NO_TIME };
enum { MAX_BUFFERS = 4, BYTES = 1 << 20 };

static int device = -1;
static uint32_t format, width = 320, height = 240, queued, sequence;
static void *buffers[MAX_BUFFERS];
static int waiting[MAX_BUFFERS];
static long place; /* in the file of frames: it goes on when the device is opened again */
static const char *const names[] = {"MJPG", "YUYV", "H264", "GREY"};
static const uint32_t sizes[][2] = {{320, 240}, {640, 480}};

static FILE *frames_of(uint32_t of)
{
    char path[4096];
    snprintf(path, sizeof path, "%s/%.4s", getenv("TOKT_V4L2_FRAMES"), (const char *)&of);
    return fopen(path, "rb");
}

static uint32_t format_at(uint32_t index)
{
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        uint32_t found;
        memcpy(&found, names[i], 4);
        FILE *file = frames_of(found);
        if (!file)
            continue;
        fclose(file);
        if (!index--)
            return found;
    }
    return 0;
}

static int failed(int error)
{
    errno = error;
    return -1;
}

static void fill(struct v4l2_pix_format *pix)
{
    pix->width = width;
    pix->height = height;
    pix->pixelformat = format;
    pix->field = V4L2_FIELD_NONE;
    pix->bytesperline = (format == V4L2_PIX_FMT_YUYV) * 2 * width + (format == V4L2_PIX_FMT_GREY) * width;
    pix->sizeimage = pix->bytesperline ? pix->bytesperline * height : BYTES;
}

static int set_format(struct v4l2_pix_format *pix)
{
    int known = 0;
    for (uint32_t i = 0; format_at(i); i++)
        if (format_at(i) == pix->pixelformat)
            format = pix->pixelformat;
    for (int i = 0; i < 2; i++)
        known |= pix->width == sizes[i][0] && pix->height == sizes[i][1];
    width = known ? pix->width : 320;
    height = known ? pix->height : 240;
    fill(pix);
    return 0;
}

static int dequeue(struct v4l2_buffer *buffer)
{
    uint32_t head[2];
    struct timespec now;
    const char *pause = getenv("TOKT_V4L2_WAIT_US");
    usleep(pause ? (useconds_t)atoi(pause) : 10000);
    FILE *file = frames_of(format);
    if (!file || !queued)
        return failed(EINVAL);
    fseek(file, place, SEEK_SET);
    if (fread(head, sizeof head, 1, file) != 1) {
        rewind(file);
        if (fread(head, sizeof head, 1, file) != 1)
            abort();
    }
    int index = waiting[0];
    memmove(waiting, waiting + 1, sizeof waiting - sizeof *waiting);
    queued--;
    if (fread(buffers[index], 1, head[1], file) != head[1])
        abort();
    place = ftell(file);
    fclose(file);
    if (head[0] == GONE)
        return failed(ENODEV);
    while (head[0] == HANGS)
        usleep(10000);
    clock_gettime(CLOCK_MONOTONIC, &now);
    buffer->index = (uint32_t)index;
    buffer->bytesused = head[1];
    buffer->flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
    buffer->flags |= head[0] == DAMAGED ? V4L2_BUF_FLAG_ERROR : 0;
    buffer->timestamp.tv_sec = head[0] == NO_TIME ? 5 : now.tv_sec;
    buffer->timestamp.tv_usec = now.tv_nsec / 1000;
    buffer->sequence = sequence++;
    return 0;
}

static int answer(unsigned long request, void *data)
{
    switch ((uint32_t)request) {
    case VIDIOC_QUERYCAP: {
        struct v4l2_capability *about = data;
        strcpy((char *)about->driver, "stand-in");
        strcpy((char *)about->card, "A camera: of tests");
        about->device_caps = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
        about->capabilities = about->device_caps | V4L2_CAP_DEVICE_CAPS;
        return 0;
    }
    case VIDIOC_ENUM_FMT: {
        struct v4l2_fmtdesc *asked = data;
        asked->pixelformat = format_at(asked->index);
        return asked->pixelformat ? 0 : failed(EINVAL);
    }
    case VIDIOC_G_FMT:
        fill(&((struct v4l2_format *)data)->fmt.pix);
        return 0;
    case VIDIOC_TRY_FMT:
    case VIDIOC_S_FMT:
        return set_format(&((struct v4l2_format *)data)->fmt.pix);
    case VIDIOC_G_PARM:
    case VIDIOC_S_PARM: {
        struct v4l2_captureparm *told = &((struct v4l2_streamparm *)data)->parm.capture;
        told->capability = V4L2_CAP_TIMEPERFRAME;
        told->timeperframe = (struct v4l2_fract){1, 30};
        return 0;
    }
    case VIDIOC_REQBUFS: {
        struct v4l2_requestbuffers *asked = data;
        asked->count = asked->count < MAX_BUFFERS ? asked->count : MAX_BUFFERS;
        queued = 0;
        return 0;
    }
    case VIDIOC_QUERYBUF: {
        struct v4l2_buffer *buffer = data;
        buffer->length = BYTES;
        buffer->m.offset = buffer->index * BYTES;
        return 0;
    }
    case VIDIOC_QBUF:
        waiting[queued++] = (int)((struct v4l2_buffer *)data)->index;
        return 0;
    case VIDIOC_DQBUF:
        return dequeue(data);
    case VIDIOC_STREAMON:
    case VIDIOC_STREAMOFF:
    case VIDIOC_ENUMINPUT:
    case VIDIOC_G_INPUT:
    case VIDIOC_S_INPUT:
        return 0;
    default:
        return failed(ENOTTY);
    }
}

static int opened(const char *path, int fd)
{
    const char *mine = getenv("TOKT_V4L2_DEVICE");
    if (fd >= 0 && mine && !strcmp(path, mine)) {
        device = fd;
        format = format ? format : format_at(0);
    }
    return fd;
}

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

int open(const char *path, int flags, ...)
{
    va_list more;
    va_start(more, flags);
    int mode = va_arg(more, int);
    va_end(more);
    return opened(path, NEXT(open)(path, flags, mode));
}

int open64(const char *path, int flags, ...)
{
    va_list more;
    va_start(more, flags);
    int mode = va_arg(more, int);
    va_end(more);
    return opened(path, NEXT(open64)(path, flags, mode));
}

int close(int fd)
{
    if (fd == device)
        device = -1;
    return NEXT(close)(fd);
}

int ioctl(int fd, unsigned long request, ...)
{
    va_list more;
    va_start(more, request);
    void *data = va_arg(more, void *);
    va_end(more);
    return fd == device && fd >= 0 ? answer(request, data) : NEXT(ioctl)(fd, request, data);
}

static void *mapped(size_t length, off_t offset)
{
    int flags = MAP_PRIVATE | MAP_ANONYMOUS;
    return buffers[offset / BYTES] = NEXT(mmap)(NULL, length, PROT_READ | PROT_WRITE, flags, -1, 0);
}

void *mmap(void *at, size_t length, int access, int flags, int fd, off_t offset)
{
    if (fd == device && fd >= 0)
        return mapped(length, offset);
    return NEXT(mmap)(at, length, access, flags, fd, offset);
}

void *mmap64(void *at, size_t length, int access, int flags, int fd, off_t offset)
{
    return mmap(at, length, access, flags, fd, offset);
}
