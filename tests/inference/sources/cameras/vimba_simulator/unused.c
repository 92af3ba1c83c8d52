/* What pymba binds when it is imported and tokt never calls: there, and refused. */
#include "vimba_types.h"

#define REFUSED(name) \
    API VmbError name(void) { return ERR_NOT_IMPLEMENTED; }

REFUSED(VmbInterfacesList)
REFUSED(VmbInterfaceOpen)
REFUSED(VmbInterfaceClose)
REFUSED(VmbFeatureInvalidationRegister)
REFUSED(VmbFeatureInvalidationUnregister)
REFUSED(VmbFrameRevoke)
REFUSED(VmbCaptureFrameWait)
REFUSED(VmbAncillaryDataOpen)
REFUSED(VmbAncillaryDataClose)
REFUSED(VmbRegistersRead)
REFUSED(VmbRegistersWrite)
