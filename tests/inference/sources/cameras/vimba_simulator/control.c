/* How a test rules the rig: SimSet and SimCount through ctypes, or VIMBA_SIMULATOR at load.
 *
 * VIMBA_SIMULATOR is a list such as "cameras=2;rate=30;1.drop_every=5": a setting of the rig, or
 * of one camera. All are numbers:
 *
 *   cameras, rate (Hz), width, height        of the rig; frames are of these moments on all cameras
 *   delay_s, jitter_s                        from a moment to its callback
 *   clock_offset_s, phase                    of the camera's clock; of its exposures, in periods
 *   drop_every, incomplete_every             each n-th moment; 0 is none
 *   again                                    hands out the last n exposures in turns; 0: new ones
 *   plugged                                  0 pulls it out, 1 puts it back, with all features reset
 *   unplug_at_s, replug_at_s                 the same by itself, so long after the first VmbStartup
 *   mute                                     sends nothing, and answers
 *   unnoticed                                the API goes on listing it when it is pulled out
 *   handle_dies                              pulled out, each call with its handle is refused
 *   usb                                      names features as USB cameras do
 *   hangs_at_open, hangs_at_close            the call does not return, but for the first opening
 *   hangs_at_exit                            so does the library's own end, with the program's
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "simulator.h"

Rig rig = {.lock = PTHREAD_MUTEX_INITIALIZER};

double now_s(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static void plug(Camera *camera, bool plugged)
{
    if (camera->plugged == plugged)
        return;
    camera->plugged = plugged;
    if (plugged)
        power_up(camera); /* a camera forgets what it was set to */
    else {
        camera->acquiring = false;
        camera->power_cycled = true;
        camera->known = camera->known && camera->unnoticed;
    }
}

void apply_plan(void)
{
    double since = rig.started ? now_s() - rig.start_s : -1;
    for (int i = 0; i < rig.cameras; i++) {
        Camera *camera = &rig.camera[i];
        if (camera->unplug_at_s >= 0 && since >= camera->unplug_at_s) {
            camera->unplug_at_s = -1;
            plug(camera, false);
        }
        if (camera->replug_at_s >= 0 && since >= camera->replug_at_s) {
            camera->replug_at_s = -1;
            plug(camera, true);
        }
    }
}

static bool set_rig(const char *name, double value)
{
    if (!strcmp(name, "cameras") && value <= MAX_CAMERAS)
        rig.cameras = (int)value;
    else if (!strcmp(name, "rate"))
        rig.rate_hz = value;
    else if (!strcmp(name, "width"))
        rig.width = (int)value;
    else if (!strcmp(name, "height"))
        rig.height = (int)value;
    else
        return false;
    for (int i = 0; i < MAX_CAMERAS; i++)
        power_up(&rig.camera[i]);
    return true;
}

static bool set_camera(Camera *camera, const char *name, double value)
{
    struct { const char *name; double *place; } numbers[] = {
        {"delay_s", &camera->delay_s}, {"jitter_s", &camera->jitter_s},
        {"clock_offset_s", &camera->clock_offset_s}, {"phase", &camera->phase},
        {"unplug_at_s", &camera->unplug_at_s}, {"replug_at_s", &camera->replug_at_s}};
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++)
        if (!strcmp(name, numbers[i].name)) {
            *numbers[i].place = value;
            return true;
        }
    if (!strcmp(name, "drop_every"))
        camera->drop_every = (int)value;
    else if (!strcmp(name, "incomplete_every"))
        camera->incomplete_every = (int)value;
    else if (!strcmp(name, "again"))
        camera->again = (int)value;
    else if (!strcmp(name, "plugged"))
        plug(camera, value != 0);
    else if (!strcmp(name, "mute"))
        camera->mute = value != 0;
    else if (!strcmp(name, "unnoticed"))
        camera->unnoticed = value != 0;
    else if (!strcmp(name, "handle_dies"))
        camera->handle_dies = value != 0;
    else if (!strcmp(name, "hangs_at_open"))
        camera->hangs_at_open = value != 0;
    else if (!strcmp(name, "hangs_at_close"))
        camera->hangs_at_close = value != 0;
    else if (!strcmp(name, "hangs_at_exit"))
        camera->hangs_at_exit = value != 0;
    else if (!strcmp(name, "usb")) {
        camera->usb = value != 0;
        power_up(camera);
    } else
        return false;
    return true;
}

/* One setting: of the rig (camera < 0) or of a camera. 0 if there is such a one. */
API int SimSet(int camera, const char *name, double value)
{
    pthread_mutex_lock(&rig.lock);
    bool done = camera < 0 ? set_rig(name, value)
                           : camera < MAX_CAMERAS && set_camera(&rig.camera[camera], name, value);
    pthread_cond_broadcast(&rig.changed);
    pthread_mutex_unlock(&rig.lock);
    return done ? 0 : -1;
}

/* What happened so far, or -1 if nothing of that name is counted. */
API long SimCount(int camera, const char *name)
{
    long count = -1;
    pthread_mutex_lock(&rig.lock);
    Camera *of = &rig.camera[camera < 0 ? 0 : camera];
    if (!strcmp(name, "delivered"))
        count = of->delivered;
    else if (!strcmp(name, "starved"))
        count = of->starved;
    else if (!strcmp(name, "starts"))
        count = of->starts;
    else if (!strcmp(name, "queued"))
        count = of->queued;
    else if (!strcmp(name, "opened"))
        count = of->opened;
    else if (!strcmp(name, "announced"))
        count = of->announced_count;
    else if (!strcmp(name, "startups"))
        count = rig.startups;
    pthread_mutex_unlock(&rig.lock);
    return count;
}

/* A number of a feature as the camera has it now; not a number where it has none. */
API double SimFeature(int camera, const char *name)
{
    pthread_mutex_lock(&rig.lock);
    Feature *found = feature_named(rig.camera[camera].feature, rig.camera[camera].features, name);
    double number = found ? found->number : NAN;
    pthread_mutex_unlock(&rig.lock);
    return number;
}

void hang_while(bool *hangs)
{
    while (*hangs)
        pthread_cond_wait(&rig.changed, &rig.lock);
}

__attribute__((destructor)) static void end(void)
{
    pthread_mutex_lock(&rig.lock);
    for (int i = 0; i < MAX_CAMERAS; i++)
        hang_while(&rig.camera[i].hangs_at_exit);
    pthread_mutex_unlock(&rig.lock);
}

static void read_environment(void)
{
    const char *given = getenv("VIMBA_SIMULATOR");
    if (!given)
        return;
    char *text = strdup(given), *rest = NULL;
    for (char *item = strtok_r(text, ";", &rest); item; item = strtok_r(NULL, ";", &rest)) {
        int camera = -1;
        char name[32];
        double value;
        if (sscanf(item, "%d.%31[a-z_]=%lf", &camera, name, &value) != 3) {
            camera = -1;
            if (sscanf(item, "%31[a-z_]=%lf", name, &value) != 2)
                abort();
        }
        if (SimSet(camera, name, value))
            abort();
    }
    free(text);
}

/* The rig as it is when the library is loaded; only while nothing is open. */
__attribute__((constructor)) API void SimReset(void)
{
    pthread_mutex_lock(&rig.lock);
    pthread_condattr_t monotonic;
    pthread_condattr_init(&monotonic);
    pthread_condattr_setclock(&monotonic, CLOCK_MONOTONIC);
    pthread_cond_init(&rig.changed, &monotonic);
    rig.rate_hz = 50;
    rig.width = 64;
    rig.height = 48;
    rig.cameras = 2;
    rig.startups = 0;
    rig.start_s = 0;
    describe_system();
    for (int i = 0; i < MAX_CAMERAS; i++) {
        rig.camera[i] = (Camera){.plugged = true, .unplug_at_s = -1, .replug_at_s = -1};
        power_up(&rig.camera[i]);
    }
    pthread_mutex_unlock(&rig.lock);
    read_environment();
}
