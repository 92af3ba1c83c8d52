# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""The compiled kernels: C headers behind checked arrays. Called by `tokt.features.compiled_kernels`.

Every function works on a range of rows into arrays its caller made, without the GIL, so that
several threads can share one frame. The caller vouches for the sizes; what it may not get wrong
here is only what memoryviews check: dtype, dimensions, C order.
"""

from libc.stdint cimport int32_t, int64_t, uint8_t, uint16_t, uint32_t


cdef extern from "instructions.h" nogil:
    int instructions_used
    int instructions_best()


cdef extern from "lbp.h" nogil:
    ctypedef struct LbpPoints:
        int points
        int columns
        int reach
        const int *first
        const int *point
        const int *row_floor
        const double *row_fraction
        const int *column_floor
        const double *column_fraction
        const uint8_t *code

    ctypedef struct LbpView:
        const uint8_t *pixels
        Py_ssize_t stride
        int height
        int width

    ctypedef struct LbpBlock:
        int row
        int column
        int height
        int width

    size_t lbp_scratch(const LbpPoints *points, int height, int width)
    void lbp_patch(const LbpView *view, const LbpPoints *points, const LbpBlock *patch,
                   double *scratch, int64_t *histogram)


cdef extern from "glcm.h" nogil:
    ctypedef struct GlcmPairs:
        uint32_t *count
        uint16_t *cells

    ctypedef struct GlcmLog2:
        const double *of
        int64_t size

    ctypedef struct GlcmPatch:
        const uint8_t *pixels
        Py_ssize_t stride
        int height
        int width

    ctypedef struct GlcmSums:
        pass

    void glcm_patch(const GlcmPatch *patch, int ignore_zeros, GlcmLog2 log2_of,
                    const double *inverse_difference, uint16_t *keys, GlcmPairs *pairs,
                    GlcmSums *sums, double *mean)


cdef extern from "area.h" nogil:
    ctypedef struct AreaTable:
        const int32_t *first
        const int32_t *source
        const float *weight

    ctypedef struct AreaFrame:
        const uint8_t *pixels
        Py_ssize_t stride
        int width
        int channels

    size_t area_scratch(const AreaFrame *frame, int width)
    void area_gray_rows(const AreaFrame *frame, const AreaTable *rows, const AreaTable *columns,
                        int first, int last, int width, float near_tie, float *scratch,
                        uint8_t *out)


INTERFACE = 1
"""To be raised here and in compiled_kernels.py with any change of what they call each other with:
a checkout whose extension was built before must fall back, and say so."""

INSTRUCTIONS = ("plain", "avx2", "avx512")[:instructions_best() + 1]
"""Instruction sets this processor can run, the best one last."""


def use_instructions(name):
    """Run the variants for one of `INSTRUCTIONS`; all give the same bits."""
    global instructions_used
    instructions_used = INSTRUCTIONS.index(name)


use_instructions(INSTRUCTIONS[len(INSTRUCTIONS) - 1])


cdef class LbpTables:
    """The sampling points of one (P, R) over a view of one size; see ``lbp.h``."""

    cdef LbpPoints points
    cdef const int[::1] first, point, row_floor, column_floor
    cdef const double[:, ::1] row_fraction, column_fraction
    cdef const uint8_t[::1] code

    def __init__(self, int reach, const int[::1] first, const int[::1] point,
                 const int[::1] row_floor, const double[:, ::1] row_fraction,
                 const int[::1] column_floor, const double[:, ::1] column_fraction,
                 const uint8_t[::1] code):
        self.first, self.point = first, point
        self.row_floor, self.row_fraction = row_floor, row_fraction
        self.column_floor, self.column_fraction = column_floor, column_fraction
        self.points.points = point.shape[0]
        self.points.columns = column_floor.shape[0]
        self.points.reach = reach
        self.points.first = &self.first[0]
        self.points.point = &self.point[0]
        self.points.row_floor = &self.row_floor[0]
        self.points.row_fraction = &self.row_fraction[0, 0]
        self.points.column_floor = &self.column_floor[0]
        self.points.column_fraction = &self.column_fraction[0, 0]
        self.code = code
        self.points.code = NULL
        if code is not None:
            self.points.code = &self.code[0]

    def scratch_size(self, int patch_height, int patch_width):
        """Number of doubles that `count_rows` needs for patches of this size."""
        return lbp_scratch(&self.points, patch_height, patch_width)

    def count_rows(self, const uint8_t[:, ::1] gray, int cols, int patch_height, int patch_width,
                   bint across_patches, int first, int last, double[::1] scratch,
                   int64_t[:, ::1] counts):
        """Add the histograms of patch rows first..last to `counts`."""
        cdef LbpView view
        cdef LbpBlock patch
        cdef int row, col
        with nogil:
            view.stride = gray.shape[1]
            for row in range(first, last):
                for col in range(cols):
                    patch.row, patch.column = row * patch_height, col * patch_width
                    patch.height, patch.width = patch_height, patch_width
                    if across_patches:
                        view.pixels = &gray[0, 0]
                        view.height, view.width = gray.shape[0], gray.shape[1]
                    else:
                        view.pixels = &gray[patch.row, patch.column]
                        view.height, view.width = patch_height, patch_width
                        patch.row = patch.column = 0
                    lbp_patch(&view, &self.points, &patch, &scratch[0],
                              &counts[row * cols + col, 0])


cdef class GlcmScratch:
    """What one thread counts pairs in; see ``glcm.h``."""

    cdef uint32_t[:, ::1] counts
    cdef uint16_t[:, ::1] cells
    cdef uint16_t[::1] keys
    cdef int64_t[::1] sums
    cdef GlcmPairs pairs[4]

    def __init__(self, uint32_t[:, ::1] counts, uint16_t[:, ::1] cells, int64_t[::1] sums,
                 uint16_t[::1] keys):
        cdef int direction
        self.counts, self.cells, self.sums, self.keys = counts, cells, sums, keys
        for direction in range(4):
            self.pairs[direction].count = &self.counts[direction, 0]
            self.pairs[direction].cells = &self.cells[direction, 0]

    @staticmethod
    def sums_size():
        """Number of int64 values that the sums of one direction take."""
        return (sizeof(GlcmSums) + 7) // 8

    def describe_rows(self, const uint8_t[:, ::1] gray, int cols, int patch_height,
                      int patch_width, bint ignore_zeros, int first, int last,
                      const double[::1] log2_of, const double[::1] inverse_difference,
                      double[:, ::1] features):
        """Write the features of patch rows first..last."""
        cdef GlcmPatch patch
        cdef GlcmLog2 logarithms
        cdef int row, col
        with nogil:
            logarithms.of, logarithms.size = &log2_of[0], log2_of.shape[0]
            patch.stride = gray.shape[1]
            patch.height, patch.width = patch_height, patch_width
            for row in range(first, last):
                for col in range(cols):
                    patch.pixels = &gray[row * patch_height, col * patch_width]
                    glcm_patch(&patch, ignore_zeros, logarithms, &inverse_difference[0],
                               &self.keys[0], self.pairs, <GlcmSums *>&self.sums[0],
                               &features[row * cols + col, 0])


cdef class AreaTables:
    """How the rows or columns of a frame make up those of a picture; see ``area.h``."""

    cdef AreaTable table
    cdef const int32_t[::1] first, source
    cdef const float[::1] weight

    def __init__(self, const int32_t[::1] first, const int32_t[::1] source,
                 const float[::1] weight):
        self.first, self.source, self.weight = first, source, weight
        self.table.first = &self.first[0]
        self.table.source = &self.source[0]
        self.table.weight = &self.weight[0]


cdef AreaFrame area_frame(const uint8_t[:, :, ::1] frame) noexcept nogil:
    cdef AreaFrame view
    view.pixels = &frame[0, 0, 0]
    view.stride = frame.shape[1] * frame.shape[2]
    view.width, view.channels = frame.shape[1], frame.shape[2]
    return view


def area_scratch_size(const uint8_t[:, :, ::1] frame, int width):
    """Number of floats that `area_gray` needs for a picture of this width."""
    cdef AreaFrame view = area_frame(frame)
    return area_scratch(&view, width)


def area_gray(const uint8_t[:, :, ::1] frame, AreaTables rows, AreaTables columns, int first,
              int last, float near_tie, float[::1] scratch, uint8_t[:, ::1] out):
    """Write rows first..last of a frame's gray picture."""
    cdef AreaFrame view = area_frame(frame)
    with nogil:
        area_gray_rows(&view, &rows.table, &columns.table, first, last, out.shape[1], near_tie,
                       &scratch[0], &out[0, 0])
