/* The stream: buffers are announced and queued, and one thread a camera fills them.
 *
 * All cameras are exposed at the same moments, n / rate after VmbStartup, as by one trigger. A
 * moment's picture (pattern.c) comes after the camera's delay. A buffer is scribbled over as soon
 * as it is queued again, so that whoever still looks at it sees.
 */
#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "simulator.h"

static const uint8_t SCRIBBLE = 0xEE;

API VmbError VmbFrameAnnounce(VmbHandle handle, VmbFrame *frame, uint32_t size)
{
    if (size != sizeof *frame)
        return ERR_STRUCT_SIZE;
    pthread_mutex_lock(&rig.lock);
    VmbError error;
    Camera *camera = camera_of(handle, &error);
    if (camera && camera->announced_count == MAX_FRAMES)
        error = ERR_RESOURCES;
    else if (camera)
        camera->announced[camera->announced_count++] = frame;
    pthread_mutex_unlock(&rig.lock);
    return error;
}

API VmbError VmbFrameRevokeAll(VmbHandle handle)
{
    pthread_mutex_lock(&rig.lock);
    Camera *camera = handle_of(handle);
    VmbError error = !camera || (camera->handle_dies && camera->power_cycled) ? ERR_BAD_HANDLE
                     : camera->capturing || camera->queued                   ? ERR_INVALID_CALL
                                                                              : SUCCESS;
    if (!error)
        camera->announced_count = 0;
    pthread_mutex_unlock(&rig.lock);
    return error;
}

API VmbError VmbCaptureFrameQueue(VmbHandle handle, VmbFrame *frame, VmbFrameCallback callback)
{
    pthread_mutex_lock(&rig.lock);
    VmbError error;
    Camera *camera = camera_of(handle, &error);
    bool announced = false;
    for (int i = 0; camera && i < camera->announced_count; i++)
        announced = announced || camera->announced[i] == frame;
    for (int i = 0; camera && i < camera->queued; i++)
        announced = announced && camera->queue[i].frame != frame; /* not twice */
    if (camera && !announced)
        error = ERR_BAD_PARAMETER;
    else if (camera && (!camera->capturing || camera->ending))
        error = ERR_INVALID_CALL;
    else if (camera) {
        memset(frame->buffer, SCRIBBLE, frame->bufferSize);
        camera->queue[camera->queued++] = (Queued){frame, callback};
        pthread_cond_broadcast(&rig.changed);
    }
    pthread_mutex_unlock(&rig.lock);
    return error;
}

API VmbError VmbCaptureQueueFlush(VmbHandle handle)
{
    pthread_mutex_lock(&rig.lock);
    Camera *camera = handle_of(handle);
    bool dead = camera && camera->handle_dies && camera->power_cycled;
    if (camera && !dead)
        camera->queued = 0;
    pthread_mutex_unlock(&rig.lock);
    return camera && !dead ? SUCCESS : ERR_BAD_HANDLE;
}

/* Wait for a time or a change; locked. */
static void wait_until(double due_s)
{
    struct timespec due = {(time_t)due_s, (long)(1e9 * (due_s - (double)(time_t)due_s))};
    pthread_cond_timedwait(&rig.changed, &rig.lock, &due);
}

static double jitter(Camera *camera, uint64_t moment)
{
    uint64_t mixed = (moment + 1) * 6364136223846793005u + (uint64_t)(camera - rig.camera);
    return camera->jitter_s * (double)(mixed >> 40 & 0xFFFF) / 65536.0;
}

static void fill(Camera *camera, VmbFrame *frame, uint64_t moment, bool incomplete)
{
    Feature *pixels = feature_named(camera->feature, camera->features, "PixelFormat");
    Feature *ticks = feature_named(camera->feature, camera->features, "GevTimestampTickFrequency");
    double taken_s = ((double)moment + camera->phase) / rig.rate_hz + camera->clock_offset_s;
    uint32_t size = (uint32_t)(rig.width * rig.height * bytes_per_pixel(pixels->text));
    frame->receiveStatus = incomplete ? RECEIVED_INCOMPLETE : RECEIVED_COMPLETE;
    frame->receiveFlags = FLAG_DIMENSION | FLAG_FRAME_ID | FLAG_TIMESTAMP;
    frame->imageSize = size;
    frame->pixelFormat = pixel_format_number(pixels->text);
    frame->width = (uint32_t)rig.width;
    frame->height = (uint32_t)rig.height;
    frame->frameID = camera->frame_id;
    frame->timestamp = (uint64_t)(taken_s * (ticks ? ticks->number : 1e9) + 0.5);
    if (size <= frame->bufferSize)
        draw(frame->buffer, incomplete ? size / 2 : size, (int)(camera - rig.camera), moment);
}

/* One moment of a camera that is acquiring; locked, but for the callback itself. */
static void expose(Camera *camera, uint64_t moment)
{
    bool drop = camera->drop_every && moment % (uint64_t)camera->drop_every == 0;
    bool incomplete =
        camera->incomplete_every && moment % (uint64_t)camera->incomplete_every == 0;
    camera->frame_id++;
    if (drop || camera->mute)
        return;
    if (!camera->queued) {
        camera->starved++;
        return;
    }
    Queued next = camera->queue[0];
    camera->queued--;
    memmove(camera->queue, camera->queue + 1, sizeof(Queued) * (size_t)camera->queued);
    uint64_t back = camera->again ? moment % (uint64_t)camera->again : 0;
    if (!camera->again) {
        camera->newest_moment = moment;
        camera->newest_id = camera->frame_id;
    }
    fill(camera, next.frame, camera->newest_moment - back, incomplete);
    next.frame->frameID = camera->newest_id - back;
    camera->delivered++;
    pthread_mutex_unlock(&rig.lock);
    next.callback((VmbHandle)(FIRST_CAMERA_HANDLE + (camera - rig.camera)), next.frame);
    pthread_mutex_lock(&rig.lock);
}

static void *stream(void *of)
{
    Camera *camera = of;
    uint64_t next = 0;
    pthread_mutex_lock(&rig.lock);
    while (!camera->ending) {
        apply_plan();
        double period = 1 / rig.rate_hz, since = now_s() - rig.start_s;
        double late = camera->delay_s + camera->phase * period;
        if (!camera->acquiring) {
            wait_until(now_s() + 0.02);
            next = 0;
            continue;
        }
        if (!next) /* the first whole moment that is still to come */
            next = (uint64_t)(since / period) + 1;
        double due = (double)next * period + late + jitter(camera, next);
        if (since < due) {
            wait_until(rig.start_s + due);
            continue;
        }
        expose(camera, next++);
    }
    pthread_mutex_unlock(&rig.lock);
    return NULL;
}

API VmbError VmbCaptureStart(VmbHandle handle)
{
    pthread_mutex_lock(&rig.lock);
    VmbError error;
    Camera *camera = camera_of(handle, &error);
    if (camera && camera->capturing)
        error = ERR_INVALID_CALL;
    else if (camera) {
        camera->ending = false;
        camera->capturing = !pthread_create(&camera->thread, NULL, stream, camera);
        error = camera->capturing ? SUCCESS : ERR_RESOURCES;
    }
    pthread_mutex_unlock(&rig.lock);
    return error;
}

/* Returns when the last callback has; so it cannot be called from one. */
API VmbError VmbCaptureEnd(VmbHandle handle)
{
    pthread_mutex_lock(&rig.lock);
    Camera *camera = handle_of(handle);
    bool own = camera && camera->capturing && pthread_equal(pthread_self(), camera->thread);
    bool dead = camera && camera->handle_dies && camera->power_cycled;
    if (!camera || own || !camera->capturing) {
        pthread_mutex_unlock(&rig.lock);
        return !camera ? ERR_BAD_HANDLE : own ? ERR_INVALID_CALL : SUCCESS;
    }
    camera->ending = true;
    pthread_cond_broadcast(&rig.changed);
    pthread_mutex_unlock(&rig.lock);
    pthread_join(camera->thread, NULL);
    pthread_mutex_lock(&rig.lock);
    camera->capturing = false;
    pthread_mutex_unlock(&rig.lock);
    return dead ? ERR_BAD_HANDLE : SUCCESS;
}

VmbError start_acquisition(Camera *camera)
{
    Feature *mode = feature_named(camera->feature, camera->features, "AcquisitionMode");
    if (strcmp(mode->text, "Continuous"))
        return ERR_INVALID_CALL; /* the simulator knows no other */
    camera->frame_id = 0;
    camera->acquiring = true;
    pthread_cond_broadcast(&rig.changed);
    return SUCCESS;
}

VmbError stop_acquisition(Camera *camera)
{
    camera->acquiring = false;
    return SUCCESS;
}
