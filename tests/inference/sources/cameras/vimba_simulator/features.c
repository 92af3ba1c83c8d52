/* Features of the system and of a camera: what there is, and reading and writing it.
 *
 * A camera's are those of a Prosilica GC on GigE, or with other names those of a USB camera, as
 * far as tokt touches them. Enum entries and ranges are as the vendor's feature reference has them.
 */
#include <stdio.h>
#include <string.h>

#include "simulator.h"

static void add(Feature *features, int *count, Feature feature)
{
    features[(*count)++] = feature;
}

#define INT(n, v, lo, hi) ((Feature){n, KIND_INT, v, lo, hi, "", NULL})
#define FLOAT(n, v, lo, hi) ((Feature){n, KIND_FLOAT, v, lo, hi, "", NULL})
#define ENUM(n, v, all) ((Feature){n, KIND_ENUM, 0, 0, 0, v, all})
#define BOOL(n, v) ((Feature){n, KIND_BOOL, v, 0, 1, "", NULL})
#define COMMAND(n) ((Feature){n, KIND_COMMAND, 0, 0, 0, "", NULL})

void describe_system(void)
{
    rig.system_features = 0;
    Feature *all = rig.system_feature;
    int *count = &rig.system_features;
    add(all, count, BOOL("GeVTLIsPresent", 1));
    add(all, count, INT("GeVDiscoveryAllDuration", 0, 0, 10000));
    add(all, count, COMMAND("GeVDiscoveryAllOnce"));
}

static void add_gige(Feature *all, int *count)
{
    add(all, count, ENUM("PixelFormat", "BayerRG8",
                         ",Mono8,BayerRG8,BayerGR8,BayerGB8,BayerBG8,RGB8Packed,BGR8Packed,"
                         "YUV422Packed,"));
    add(all, count, FLOAT("ExposureTimeAbs", 15000, 10, 1e6));
    add(all, count, FLOAT("AcquisitionFrameRateAbs", rig.rate_hz, 0.1, 1000));
    add(all, count, ENUM("TriggerSource", "Freerun", ",Freerun,Line1,Line2,FixedRate,Software,"));
    add(all, count, INT("GVSPPacketSize", 8228, 500, 9000));
    add(all, count, COMMAND("GVSPAdjustPacketSize"));
    add(all, count, INT("StreamBytesPerSecond", 115e6, 1e6, 124e6));
    add(all, count, INT("GevTimestampTickFrequency", 36858974, 0, 1e12));
    add(all, count, ENUM("PtpMode", "Off", ",Off,Slave,Master,Auto,"));
    add(all, count, ENUM("PtpStatus", "Off", ",Off,Slave,Master,"));
}

static void add_usb(Feature *all, int *count)
{
    add(all, count, ENUM("PixelFormat", "Mono12p", ",Mono12p,BayerRG12p,RGB8,BGR8,"));
    add(all, count, FLOAT("ExposureTime", 15000, 10, 1e6));
    add(all, count, BOOL("AcquisitionFrameRateEnable", 0));
    add(all, count, FLOAT("AcquisitionFrameRate", rig.rate_hz, 0.1, 1000));
    add(all, count, ENUM("TriggerSource", "Line0", ",Line0,Line1,Software,"));
}

void power_up(Camera *camera)
{
    camera->features = 0;
    Feature *all = camera->feature;
    int *count = &camera->features;
    add(all, count, ENUM("AcquisitionMode", "SingleFrame", ",Continuous,SingleFrame,MultiFrame,"));
    add(all, count, COMMAND("AcquisitionStart"));
    add(all, count, COMMAND("AcquisitionStop"));
    add(all, count, INT("Width", rig.width, 8, 4096));
    add(all, count, INT("Height", rig.height, 8, 4096));
    add(all, count, INT("PayloadSize", 0, 0, 1e9));
    add(all, count, ENUM("ExposureAuto", "Continuous", ",Off,Once,Continuous,"));
    add(all, count, FLOAT("Gain", 0, 0, 30));
    add(all, count, ENUM("GainAuto", "Off", ",Off,Once,Continuous,"));
    add(all, count, ENUM("TriggerSelector", "AcquisitionStart", ",FrameStart,AcquisitionStart,"));
    add(all, count, ENUM("TriggerMode", "Off", ",Off,On,"));
    (camera->usb ? add_usb : add_gige)(all, count);
}

Feature *feature_named(Feature *features, int count, const char *name)
{
    for (int i = 0; i < count; i++)
        if (!strcmp(features[i].name, name))
            return &features[i];
    return NULL;
}

/* VmbPixelFormat: pymba/vimba_pixelformat.py. */
uint32_t pixel_format_number(const char *name)
{
    static const struct { const char *name; uint32_t number; } formats[] = {
        {"Mono8", 0x01080001}, {"BayerGR8", 0x01080008}, {"BayerRG8", 0x01080009},
        {"BayerGB8", 0x0108000A}, {"BayerBG8", 0x0108000B}, {"RGB8Packed", 0x02180014},
        {"RGB8", 0x02180014}, {"BGR8Packed", 0x02180015}, {"BGR8", 0x02180015},
        {"YUV422Packed", 0x0210001F}};
    for (size_t i = 0; i < sizeof formats / sizeof *formats; i++)
        if (!strcmp(name, formats[i].name))
            return formats[i].number;
    return 0x010C0047; /* Mono12p */
}

int bytes_per_pixel(const char *name)
{
    uint32_t bits = pixel_format_number(name) >> 16 & 0xFF;
    return bits == 24 ? 3 : bits == 8 ? 1 : 2;
}

/* The features that a handle has, or the error that says why it has none. */
static Feature *features_of(VmbHandle handle, int *count, VmbError *error)
{
    *error = SUCCESS;
    if (handle == SYSTEM_HANDLE) {
        *count = rig.system_features;
        return rig.system_feature;
    }
    Camera *camera = camera_of(handle, error);
    if (!camera)
        return NULL;
    *count = camera->features;
    Feature *pixels = feature_named(camera->feature, *count, "PixelFormat");
    Feature *size = feature_named(camera->feature, *count, "PayloadSize");
    size->number = rig.width * rig.height * bytes_per_pixel(pixels->text);
    return camera->feature;
}

static Feature *find(VmbHandle handle, const char *name, int kind, VmbError *error)
{
    int count = 0;
    Feature *all = features_of(handle, &count, error);
    Feature *found = all ? feature_named(all, count, name) : NULL;
    if (all && !found)
        *error = ERR_NOT_FOUND;
    else if (found && kind && found->kind != kind) {
        *error = ERR_WRONG_TYPE;
        found = NULL;
    }
    return found;
}

static VmbFeatureInfo info_of(const Feature *feature)
{
    return (VmbFeatureInfo){.name = feature->name, .featureDataType = (uint32_t)feature->kind,
                            .featureFlags = 3, .category = "/", .displayName = feature->name};
}

API VmbError VmbFeaturesList(VmbHandle handle, VmbFeatureInfo *infos, uint32_t room,
                             uint32_t *found, uint32_t size)
{
    if (size != sizeof *infos)
        return ERR_STRUCT_SIZE;
    pthread_mutex_lock(&rig.lock);
    int count = 0;
    VmbError error;
    Feature *all = features_of(handle, &count, &error);
    if (all) {
        *found = (uint32_t)count;
        for (uint32_t i = 0; infos && i < room && i < *found; i++)
            infos[i] = info_of(&all[i]);
        if (infos && *found > room)
            error = ERR_MORE_DATA;
    }
    pthread_mutex_unlock(&rig.lock);
    return error;
}

API VmbError VmbFeatureInfoQuery(VmbHandle handle, const char *name, VmbFeatureInfo *info,
                                 uint32_t size)
{
    if (size != sizeof *info)
        return ERR_STRUCT_SIZE;
    pthread_mutex_lock(&rig.lock);
    VmbError error;
    Feature *found = find(handle, name, 0, &error);
    if (found)
        *info = info_of(found);
    pthread_mutex_unlock(&rig.lock);
    return error;
}

/* Reading or writing a number, whatever its kind. */
static VmbError number(VmbHandle handle, const char *name, int kind, double *get,
                       const double *set)
{
    pthread_mutex_lock(&rig.lock);
    VmbError error;
    Feature *found = find(handle, name, kind, &error);
    if (found && get)
        *get = found->number;
    if (found && set) {
        if (*set < found->least || *set > found->most)
            error = ERR_INVALID_VALUE;
        else
            found->number = *set;
    }
    pthread_mutex_unlock(&rig.lock);
    return error;
}

static VmbError range(VmbHandle handle, const char *name, int kind, double *least, double *most)
{
    pthread_mutex_lock(&rig.lock);
    VmbError error;
    Feature *found = find(handle, name, kind, &error);
    if (found) {
        *least = found->least;
        *most = found->most;
    }
    pthread_mutex_unlock(&rig.lock);
    return error;
}

API VmbError VmbFeatureIntGet(VmbHandle handle, const char *name, int64_t *value)
{
    double got = 0;
    VmbError error = number(handle, name, KIND_INT, &got, NULL);
    *value = (int64_t)got;
    return error;
}

API VmbError VmbFeatureIntSet(VmbHandle handle, const char *name, int64_t value)
{
    double given = (double)value;
    return number(handle, name, KIND_INT, NULL, &given);
}

API VmbError VmbFeatureIntRangeQuery(VmbHandle handle, const char *name, int64_t *least,
                                     int64_t *most)
{
    double low = 0, high = 0;
    VmbError error = range(handle, name, KIND_INT, &low, &high);
    *least = (int64_t)low;
    *most = (int64_t)high;
    return error;
}

API VmbError VmbFeatureFloatGet(VmbHandle handle, const char *name, double *value)
{
    return number(handle, name, KIND_FLOAT, value, NULL);
}

API VmbError VmbFeatureFloatSet(VmbHandle handle, const char *name, double value)
{
    return number(handle, name, KIND_FLOAT, NULL, &value);
}

API VmbError VmbFeatureFloatRangeQuery(VmbHandle handle, const char *name, double *least,
                                       double *most)
{
    return range(handle, name, KIND_FLOAT, least, most);
}

API VmbError VmbFeatureBoolGet(VmbHandle handle, const char *name, bool *value)
{
    double got = 0;
    VmbError error = number(handle, name, KIND_BOOL, &got, NULL);
    *value = got != 0;
    return error;
}

API VmbError VmbFeatureBoolSet(VmbHandle handle, const char *name, bool value)
{
    double given = value;
    return number(handle, name, KIND_BOOL, NULL, &given);
}

API VmbError VmbFeatureEnumGet(VmbHandle handle, const char *name, const char **value)
{
    pthread_mutex_lock(&rig.lock);
    VmbError error;
    Feature *found = find(handle, name, KIND_ENUM, &error);
    if (found)
        *value = found->text;
    pthread_mutex_unlock(&rig.lock);
    return error;
}

API VmbError VmbFeatureEnumSet(VmbHandle handle, const char *name, const char *value)
{
    char entry[40];
    snprintf(entry, sizeof entry, ",%s,", value);
    pthread_mutex_lock(&rig.lock);
    VmbError error;
    Feature *found = find(handle, name, KIND_ENUM, &error);
    if (found && !strstr(found->entries, entry))
        error = ERR_INVALID_VALUE;
    else if (found) {
        snprintf(found->text, sizeof found->text, "%s", value);
        /* Clocks are together as soon as they are asked to be. */
        Feature *status = find(handle, "PtpStatus", KIND_ENUM, &(VmbError){0});
        if (status && !strcmp(name, "PtpMode"))
            strcpy(status->text, strcmp(value, "Off") ? "Slave" : "Off");
    }
    pthread_mutex_unlock(&rig.lock);
    return error;
}

/* The entries' names stay where they are for as long as the library does. */
API VmbError VmbFeatureEnumRangeQuery(VmbHandle handle, const char *name, const char **names,
                                      uint32_t room, uint32_t *found_count)
{
    static char kept[64][32];
    static int used;
    pthread_mutex_lock(&rig.lock);
    VmbError error;
    Feature *found = find(handle, name, KIND_ENUM, &error);
    uint32_t count = 0;
    for (const char *at = found ? found->entries + 1 : ""; *at; at = strchr(at, ',') + 1) {
        if (names && count < room) {
            int length = (int)(strchr(at, ',') - at), slot = 0;
            while (slot < used &&
                   (strncmp(kept[slot], at, (size_t)length) || kept[slot][length]))
                slot++;
            if (slot == used && used < 64)
                snprintf(kept[used++], sizeof kept[0], "%.*s", length, at);
            names[count] = kept[slot];
        }
        count++;
    }
    *found_count = count;
    pthread_mutex_unlock(&rig.lock);
    return error;
}

API VmbError VmbFeatureStringGet(VmbHandle handle, const char *name, char *buffer, uint32_t room,
                                 uint32_t *filled)
{
    (void)buffer, (void)room, (void)filled;
    VmbError error;
    pthread_mutex_lock(&rig.lock);
    find(handle, name, KIND_STRING, &error);
    pthread_mutex_unlock(&rig.lock);
    return error;
}

API VmbError VmbFeatureStringSet(VmbHandle handle, const char *name, const char *value)
{
    (void)value;
    return VmbFeatureStringGet(handle, name, NULL, 0, NULL);
}

static VmbError run(VmbHandle handle, const char *name)
{
    VmbError error;
    if (!find(handle, name, KIND_COMMAND, &error))
        return error;
    if (handle == SYSTEM_HANDLE) { /* GeVDiscoveryAllOnce: the only way to find a new camera */
        apply_plan();
        for (int i = 0; i < rig.cameras; i++)
            rig.camera[i].known = rig.camera[i].plugged ||
                                  (rig.camera[i].known && rig.camera[i].unnoticed);
        return SUCCESS;
    }
    Camera *camera = camera_of(handle, &error);
    if (!strcmp(name, "AcquisitionStart"))
        return start_acquisition(camera);
    if (!strcmp(name, "AcquisitionStop"))
        return stop_acquisition(camera);
    /* GVSPAdjustPacketSize: this network lets plain Ethernet packets through. */
    feature_named(camera->feature, camera->features, "GVSPPacketSize")->number = 1500;
    return SUCCESS;
}

API VmbError VmbFeatureCommandRun(VmbHandle handle, const char *name)
{
    pthread_mutex_lock(&rig.lock);
    VmbError error = run(handle, name);
    pthread_mutex_unlock(&rig.lock);
    return error;
}

API VmbError VmbFeatureCommandIsDone(VmbHandle handle, const char *name, bool *done)
{
    VmbError error;
    pthread_mutex_lock(&rig.lock);
    *done = find(handle, name, KIND_COMMAND, &error) != NULL;
    pthread_mutex_unlock(&rig.lock);
    return error;
}
