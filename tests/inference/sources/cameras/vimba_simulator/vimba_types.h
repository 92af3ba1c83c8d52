/* The types of the Vimba C API that pymba 0.3.7 binds.
 *
 * Names are those of VimbaC.h and VmbCommonTypes.h; each layout is that of the ctypes structure of
 * the same name in pymba/vimba_c.py, and each error code that of pymba/vimba_exception.py. Written
 * from those: nothing here is copied from the vendor's headers.
 */
#ifndef VIMBA_TYPES_H
#define VIMBA_TYPES_H

#include <stdbool.h>
#include <stdint.h>

#define API __attribute__((visibility("default")))

typedef int32_t VmbError;
typedef uintptr_t VmbHandle; /* pymba: c_void_p; the system's handle is 1 (pymba/system.py) */

enum { /* pymba/vimba_exception.py */
    SUCCESS = 0,
    ERR_STARTUP_NOT_CALLED = -2,
    ERR_NOT_FOUND = -3,
    ERR_BAD_HANDLE = -4,
    ERR_NOT_OPEN = -5,
    ERR_ACCESS = -6,
    ERR_BAD_PARAMETER = -7,
    ERR_STRUCT_SIZE = -8,
    ERR_MORE_DATA = -9,
    ERR_WRONG_TYPE = -10,
    ERR_INVALID_VALUE = -11,
    ERR_TIMEOUT = -12,
    ERR_RESOURCES = -14,
    ERR_INVALID_CALL = -15,
    ERR_NOT_IMPLEMENTED = -17,
};

enum { /* VmbFeatureDataType: pymba/feature.py */
    KIND_INT = 1,
    KIND_FLOAT,
    KIND_ENUM,
    KIND_STRING,
    KIND_BOOL,
    KIND_COMMAND,
};

enum { RECEIVED_COMPLETE = 0, RECEIVED_INCOMPLETE = -1 };              /* VmbFrameStatusType */
enum { FLAG_DIMENSION = 1, FLAG_FRAME_ID = 4, FLAG_TIMESTAMP = 8 };    /* VmbFrameFlagsType */

typedef struct {
    uint32_t major, minor, patch;
} VmbVersionInfo;

typedef struct {
    const char *cameraIdString, *cameraName, *modelName, *serialString;
    uint32_t permittedAccess;
    const char *interfaceIdString;
} VmbCameraInfo;

typedef struct {
    const char *name;
    uint32_t featureDataType, featureFlags;
    const char *category, *displayName;
    uint32_t pollingTime;
    const char *unit, *representation;
    uint32_t visibility;
    const char *tooltip, *description, *sfncNamespace;
    bool isStreamable, hasAffectedFeatures, hasSelectedFeatures;
} VmbFeatureInfo;

typedef struct {
    void *buffer;
    uint32_t bufferSize;
    void *context[4];
    int32_t receiveStatus;
    uint32_t receiveFlags;
    uint32_t imageSize, ancillarySize;
    uint32_t pixelFormat;
    uint32_t width, height, offsetX, offsetY;
    uint64_t frameID, timestamp;
} VmbFrame;

_Static_assert(sizeof(VmbFrame) == 104, "VmbFrame has 104 bytes in pymba 0.3.7");

typedef void (*VmbFrameCallback)(VmbHandle camera, VmbFrame *frame);

#endif
