/* Start and end of the API, and which cameras it finds. */
#include <ctype.h>
#include <stdio.h>
#include <string.h>

#include "simulator.h"

/* Ways to name each camera: its ID, serial number, IP address and MAC address. */
static const char *IDS[] = {"DEV_000F31000001", "DEV_000F31000002", "DEV_000F31000003",
                            "DEV_000F31000004"};
static const char *SERIALS[] = {"02-2130A-06001", "02-2130A-06002", "02-2130A-06003",
                                "02-2130A-06004"};
static const char *ADDRESSES[] = {"169.254.1.1", "169.254.1.2", "169.254.1.3", "169.254.1.4"};
static const char *MACS[] = {"000F31000001", "000F31000002", "000F31000003", "000F31000004"};

API VmbError VmbVersionQuery(VmbVersionInfo *version, uint32_t size)
{
    if (size != sizeof *version)
        return ERR_STRUCT_SIZE;
    *version = (VmbVersionInfo){1, 8, 3};
    return SUCCESS;
}

API VmbError VmbStartup(void)
{
    pthread_mutex_lock(&rig.lock);
    if (!rig.start_s)
        rig.start_s = now_s();
    rig.started = true;
    rig.startups++;
    pthread_mutex_unlock(&rig.lock);
    return SUCCESS;
}

API void VmbShutdown(void)
{
    pthread_mutex_lock(&rig.lock);
    rig.started = false;
    for (int i = 0; i < MAX_CAMERAS; i++)
        rig.camera[i].known = false;
    pthread_mutex_unlock(&rig.lock);
}

static void describe(int index, VmbCameraInfo *info)
{
    *info = (VmbCameraInfo){.cameraIdString = IDS[index], .cameraName = "Simulated camera",
                            .modelName = rig.camera[index].usb ? "Alvium" : "Prosilica GC1380C",
                            .serialString = SERIALS[index],
                            .permittedAccess = rig.camera[index].opened ? 0 : 1,
                            .interfaceIdString = "eth0"};
}

API VmbError VmbCamerasList(VmbCameraInfo *infos, uint32_t room, uint32_t *found, uint32_t size)
{
    if (size != sizeof *infos)
        return ERR_STRUCT_SIZE;
    pthread_mutex_lock(&rig.lock);
    apply_plan();
    VmbError error = rig.started ? SUCCESS : ERR_STARTUP_NOT_CALLED;
    *found = 0;
    for (int i = 0; i < rig.cameras && !error; i++)
        if (rig.camera[i].known) {
            if (*found < room)
                describe(i, &infos[*found]);
            ++*found;
        }
    if (!error && room && *found > room)
        error = ERR_MORE_DATA;
    pthread_mutex_unlock(&rig.lock);
    return error;
}

static int index_of(const char *name)
{
    for (int i = 0; i < rig.cameras; i++)
        if (rig.camera[i].known && (!strcmp(name, IDS[i]) || !strcmp(name, SERIALS[i]) ||
                                    !strcmp(name, ADDRESSES[i]) || !strcmp(name, MACS[i])))
            return i;
    return -1;
}

API VmbError VmbCameraInfoQuery(const char *name, VmbCameraInfo *info, uint32_t size)
{
    if (size != sizeof *info)
        return ERR_STRUCT_SIZE;
    pthread_mutex_lock(&rig.lock);
    apply_plan();
    int index = index_of(name);
    if (index >= 0)
        describe(index, info);
    pthread_mutex_unlock(&rig.lock);
    return index < 0 ? ERR_NOT_FOUND : SUCCESS;
}

API VmbError VmbCameraOpen(const char *name, uint32_t mode, VmbHandle *handle)
{
    (void)mode;
    pthread_mutex_lock(&rig.lock);
    apply_plan();
    int index = index_of(name);
    VmbError error = SUCCESS;
    if (index >= 0 && rig.camera[index].starts)
        hang_while(&rig.camera[index].hangs_at_open);
    if (index < 0 || !rig.camera[index].plugged)
        error = ERR_NOT_FOUND;
    else if (rig.camera[index].opened)
        error = ERR_ACCESS;
    else {
        rig.camera[index].opened = true;
        rig.camera[index].power_cycled = false;
        rig.camera[index].starts++;
        *handle = (VmbHandle)(FIRST_CAMERA_HANDLE + index);
    }
    pthread_mutex_unlock(&rig.lock);
    return error;
}

API VmbError VmbCameraClose(VmbHandle handle)
{
    pthread_mutex_lock(&rig.lock);
    Camera *camera = handle_of(handle);
    if (camera)
        hang_while(&camera->hangs_at_close);
    VmbError error = !camera ? ERR_BAD_HANDLE : camera->capturing ? ERR_INVALID_CALL : SUCCESS;
    if (camera && camera->handle_dies && camera->power_cycled) {
        /* The API has let go of everything by itself, and says only that the handle is bad. */
        error = ERR_BAD_HANDLE;
        camera->opened = false;
        camera->queued = camera->announced_count = 0;
    } else if (!error)
        camera->opened = false;
    pthread_mutex_unlock(&rig.lock);
    return error;
}

Camera *handle_of(VmbHandle handle)
{
    if (handle < FIRST_CAMERA_HANDLE || handle >= FIRST_CAMERA_HANDLE + MAX_CAMERAS)
        return NULL;
    Camera *camera = &rig.camera[handle - FIRST_CAMERA_HANDLE];
    return camera->opened ? camera : NULL;
}

Camera *camera_of(VmbHandle handle, VmbError *error)
{
    apply_plan();
    Camera *camera = handle_of(handle);
    bool gone = camera && (!camera->plugged || camera->power_cycled);
    *error = !camera ? ERR_BAD_HANDLE
             : gone  ? (camera->handle_dies ? ERR_BAD_HANDLE : ERR_TIMEOUT)
                     : SUCCESS;
    return *error ? NULL : camera;
}
