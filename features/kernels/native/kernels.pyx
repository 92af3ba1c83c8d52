# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""The compiled kernels: C headers behind checked arrays. Called by `tokt.features.kernels.compiled_kernels`.

Every function works on a range of rows into arrays its caller made, without the GIL, so that
several threads can share one frame. The caller vouches for the sizes; what it may not get wrong
here is only what memoryviews check: dtype, dimensions, C order.
"""

from libc.stdint cimport int16_t, int32_t, int64_t, uint8_t, uint16_t, uint32_t, uint64_t


cdef extern from "instructions.h" nogil:
    const char *const instructions_names[3]
    int instructions_used
    int instructions_best()


cdef extern from "lbp.h" nogil:
    ctypedef struct LbpPoints:
        int points, columns, reach
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
        int height, width

    ctypedef struct LbpBlock:
        int row, column, height, width

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
        int height, width

    ctypedef struct GlcmSums:
        pass

    void glcm_patch(const GlcmPatch *patch, int ignore_zeros, GlcmLog2 log2_of,
                    const double *inverse_difference, uint16_t *keys, GlcmPairs *pairs,
                    GlcmSums *sums, double *mean)


cdef extern from "area.h" nogil:
    ctypedef struct AreaFrame:
        const uint8_t *pixels
        Py_ssize_t stride
        int width, channels

    ctypedef struct AreaTable:
        const int32_t *source
        const int32_t *inner
        const int32_t *first
        const int32_t *last
        int32_t whole

    ctypedef struct TieTable:
        const int32_t *first
        const int32_t *source
        const float *weight

    ctypedef struct AreaTables:
        AreaTable rows, columns
        TieTable tie_rows, tie_columns
        int width
        double unit
        float near_tie

    size_t area_scratch(const AreaFrame *frame, int width)
    void area_rows(const AreaFrame *frame, const AreaTables *tables, int first, int last,
                   char *scratch, uint16_t *gray16, uint8_t *gray8)


cdef extern from "means.h" nogil:
    ctypedef struct MeansTaps:
        const int32_t *source
        const float *weight

    void means_halved(const AreaFrame *frame, int first, int last, uint8_t *scratch, float *out)
    void means_rows(const float *view, Py_ssize_t stride, const MeansTaps *rows,
                    const MeansTaps *columns, int first, int last, Py_ssize_t width, float *along,
                    float *out)


cdef extern from "contrast.h" nogil:
    ctypedef struct ContrastView:
        const float *view
        Py_ssize_t height, width, window
        float gain, least

    size_t contrast_scratch(const ContrastView *view)
    void contrast_view(const ContrastView *view, double *scratch, float *sigma, uint8_t *even)


cdef extern from "quantization.h" nogil:
    ctypedef struct Gray16Picture:
        const uint16_t *pixels
        int height, width

    ctypedef struct QuantizeSettings:
        int smooth, window, ratio
        double ratio_of, min_around, offset, top

    size_t quantize_scratch(const QuantizeSettings *settings, int width)
    void summed_area(const Gray16Picture *picture, uint32_t *sums)
    void quantize_rows(const uint32_t *sums, int height, int width,
                       const QuantizeSettings *settings, double scale, int first, int last,
                       double *scratch, uint8_t *out)
    void count_levels(const uint8_t *pixels, Py_ssize_t stride, int height, int width,
                      int64_t *counts)


cdef extern from "marks.h" nogil:
    ctypedef struct MarksKinds:
        int pieces, words, tiles, lag, largest
        const uint64_t *weights

    void marks_row(const uint8_t *row, const MarksKinds *kinds, uint64_t *hashes,
                   uint64_t *rising, uint64_t *falling)
    void marks_counts(const uint64_t *one, const uint64_t *other, Py_ssize_t half, int64_t *counts)


cdef extern from "structure.h" nogil:
    ctypedef struct PatchedPicture:
        const uint8_t *pixels
        int height, width, cols, patch_height, patch_width

    size_t structure_scratch(const PatchedPicture *picture)
    void structure_rows(const PatchedPicture *picture, int first, int last, int32_t *scratch,
                        int64_t *sums)


cdef extern from "gradient.h" nogil:
    ctypedef struct GradientPatches:
        Gray16Picture picture
        int cols, patch_height, patch_width, box

    size_t gradient_scratch(const GradientPatches *patches)
    void gradient_rows(const GradientPatches *patches, int first, int last, double *scratch,
                       int64_t *sums)


cdef extern from "detail.h" nogil:
    ctypedef struct DetailRows:
        const AreaFrame *frame
        const int64_t *rows
        int cols, count
        const int32_t *lags

    ctypedef struct CurvaturePatches:
        Gray16Picture picture
        int cols, patch_height, patch_width

    void detail_rows(const DetailRows *detail, int count, int64_t *sums)
    size_t curvature_scratch(const CurvaturePatches *patches, int count)
    void curvature_rows(const CurvaturePatches *patches, const int32_t *lags, int count, int first,
                        int last, uint32_t *scratch, int64_t *sums)


cdef extern from "boxes.h" nogil:
    size_t boxes_scratch(const AreaFrame *frame)
    void boxes_rows(const AreaFrame *frame, const int64_t *rows, const int64_t *columns, int count,
                    int first, int last, uint16_t *scratch, int64_t *sums)


cdef extern from "lines.h" nogil:
    ctypedef struct LineKinds:
        int middle, count
        const int32_t *samples

    size_t lines_scratch(const PatchedPicture *picture, const LineKinds *kinds)
    void lines_rows(const PatchedPicture *picture, const LineKinds *kinds, int first, int last,
                    int16_t *scratch, int64_t *sums)


cdef extern from "nearest.h" nogil:
    ctypedef struct NearestPoints:
        int points, reach, across_patches
        const int32_t *moves

    size_t nearest_scratch(const PatchedPicture *picture, const NearestPoints *points)
    void nearest_rows(const PatchedPicture *picture, const NearestPoints *points, int first,
                      int last, uint8_t *scratch, int64_t *histograms)


cdef extern from "match.h" nogil:
    ctypedef struct MatchSettings:
        int smallest, count, block, zero, texture, uniqueness

    ctypedef struct MatchViews:
        const uint8_t *left
        const uint8_t *right
        const uint8_t *wanted
        int width, top, bottom, first, last

    size_t match_scratch(const MatchSettings *settings, int width)
    void match_views(const MatchViews *views, const MatchSettings *settings, uint16_t *scratch,
                     int16_t *out)


# Cython's own code, which only checks and hands over, is compiled for size: gcc 12's wheel is 45 kB
# smaller by it, and no kernel slower.
cdef extern from *:
    """
    #if defined(__GNUC__) && !defined(__clang__)
    #pragma GCC optimize("Os")
    #endif
    """


INTERFACE = 10
"""To be raised here and in compiled_kernels.py with any change of what they call each other with:
a checkout whose extension was built before must fall back, and say so."""

INSTRUCTIONS = tuple([instructions_names[i].decode() for i in range(instructions_best() + 1)])
"""Instruction sets this processor can run, the best one last."""


def use_instructions(name):
    """Run the variants for one of `INSTRUCTIONS`; all give the same bits."""
    global instructions_used
    instructions_used = INSTRUCTIONS.index(name)


use_instructions(INSTRUCTIONS[len(INSTRUCTIONS) - 1])


cdef class Scratch:
    """Memory of one thread for a kernel's intermediate results.

    It is used again for every frame, because a large block that is freed and asked for again costs
    more in page faults than the counting itself.
    """

    cdef readonly bytearray memory

    def __init__(self):
        self.memory = bytearray(1)

    cdef char *of(self, size_t size):
        """That many bytes, their content left from the last use."""
        if <size_t>len(self.memory) < size:
            self.memory = bytearray(size)
        return self.memory


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

    def count_rows(self, const uint8_t[:, ::1] gray, int cols, int patch_height, int patch_width,
                   bint across_patches, int64_t[:, ::1] counts, int first, int last,
                   Scratch scratch):
        """Add the histograms of patch rows first..last to `counts`."""
        cdef size_t needed = lbp_scratch(&self.points, patch_height, patch_width)
        cdef double *memory = <double *>scratch.of(needed * sizeof(double))
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
                    lbp_patch(&view, &self.points, &patch, memory, &counts[row * cols + col, 0])


cdef class GlcmScratch:
    """What one thread counts pairs in, every count zero between calls; see ``glcm.h``."""

    cdef bytearray counts, cells, sums
    cdef uint16_t[::1] keys
    cdef GlcmPairs pairs[4]

    def __init__(self):
        cdef int direction
        self.counts = bytearray(4 * 65536 * sizeof(uint32_t))
        self.cells = bytearray(4 * 65536 * sizeof(uint16_t))
        self.sums = bytearray(sizeof(GlcmSums))
        self.keys = memoryview(bytearray(2)).cast("H")
        for direction in range(4):
            self.pairs[direction].count = <uint32_t *><char *>self.counts + direction * 65536
            self.pairs[direction].cells = <uint16_t *><char *>self.cells + direction * 65536

    def describe_rows(self, const uint8_t[:, ::1] gray, int cols, int patch_height,
                      int patch_width, bint ignore_zeros, int first, int last,
                      const double[::1] log2_of, const double[::1] inverse_difference,
                      double[:, ::1] features):
        """Write the features of patch rows first..last."""
        if self.keys.shape[0] < 4 * patch_width:
            self.keys = memoryview(bytearray(4 * patch_width * sizeof(uint16_t))).cast("H")
        cdef GlcmSums *sums = <GlcmSums *><char *>self.sums
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
                    # `&self.keys[0]` in place: from a local pointer gcc makes this a sixth slower.
                    glcm_patch(&patch, ignore_zeros, logarithms, &inverse_difference[0],
                               &self.keys[0], self.pairs, sums, &features[row * cols + col, 0])


cdef AreaTable area_table(arrays):
    cdef AreaTable table
    cdef const int32_t[::1] source = arrays[0], inner = arrays[1], first = arrays[2]
    cdef const int32_t[::1] last = arrays[3]
    table.source, table.inner, table.first = &source[0], &inner[0], &first[0]
    table.last, table.whole = &last[0], arrays[4]
    return table


cdef TieTable tie_table(arrays):
    cdef TieTable table
    cdef const int32_t[::1] first = arrays[0], source = arrays[1]
    cdef const float[::1] weight = arrays[2]
    table.first, table.source, table.weight = &first[0], &source[0], &weight[0]
    return table


cdef class GrayPictures:
    """The gray pictures of one size of frames of one size; see ``area.h``."""

    cdef AreaTables tables
    cdef object kept

    def __init__(self, rows, columns, tie_rows, tie_columns, int width, double unit,
                 float near_tie):
        self.kept = rows, columns, tie_rows, tie_columns
        self.tables.rows, self.tables.columns = area_table(rows), area_table(columns)
        self.tables.tie_rows, self.tables.tie_columns = tie_table(tie_rows), tie_table(tie_columns)
        self.tables.width, self.tables.unit, self.tables.near_tie = width, unit, near_tie

    def make_rows(self, const uint8_t[:, :, ::1] frame, uint16_t[:, ::1] gray16,
                  uint8_t[:, ::1] gray8, int first, int last, Scratch scratch):
        """Write rows first..last of the 16-bit picture and of the plain one, or of one of them."""
        cdef AreaFrame view = area_frame(frame)
        cdef char *memory = scratch.of(area_scratch(&view, self.tables.width))
        cdef uint16_t *deep = NULL
        cdef uint8_t *plain = NULL
        if gray16 is not None:
            deep = &gray16[0, 0]
        if gray8 is not None:
            plain = &gray8[0, 0]
        with nogil:
            area_rows(&view, &self.tables, first, last, memory, deep, plain)


cdef AreaFrame area_frame(const uint8_t[:, :, ::1] frame) noexcept nogil:
    cdef AreaFrame view
    view.pixels = &frame[0, 0, 0]
    view.stride = frame.shape[1] * frame.shape[2]
    view.width, view.channels = frame.shape[1], frame.shape[2]
    return view


def halved_gray(const uint8_t[:, :, ::1] frame, float[:, ::1] out, int first, int last,
                Scratch scratch):
    """Write rows first..last of the means of 2 x 2 pixels."""
    cdef AreaFrame view = area_frame(frame)
    cdef uint8_t *memory = <uint8_t *>scratch.of(2 * view.width)
    with nogil:
        means_halved(&view, first, last, memory, &out[0, 0])


def area_means(const float[:, ::1] view, const int32_t[::1] row, const float[:, ::1] row_weights,
               const int32_t[::1] column, const float[:, ::1] column_weights, float[:, ::1] out,
               int first, int last, Scratch scratch):
    """Write rows first..last of a view resized: from which row and column on, with three weights."""
    cdef MeansTaps rows, columns
    rows.source, rows.weight = &row[0], &row_weights[0, 0]
    columns.source, columns.weight = &column[0], &column_weights[0, 0]
    cdef float *memory = <float *>scratch.of(out.shape[1] * sizeof(float))
    with nogil:
        means_rows(&view[0, 0], view.shape[1], &rows, &columns, first, last, out.shape[1], memory,
                   &out[0, 0])


def local_contrast(const float[:, ::1] view, int window, float gain, float least,
                   float[:, ::1] sigma, uint8_t[:, ::1] even, Scratch scratch):
    """Write the deviations around a view's pixels, and the view made even by them."""
    cdef ContrastView contrast
    contrast.view, contrast.height, contrast.width = &view[0, 0], view.shape[0], view.shape[1]
    contrast.window, contrast.gain, contrast.least = window, gain, least
    cdef double *memory = <double *>scratch.of(contrast_scratch(&contrast) * sizeof(double))
    with nogil:
        contrast_view(&contrast, memory, &sigma[0, 0], &even[0, 0])


cdef Gray16Picture gray16_picture(const uint16_t[:, ::1] gray16) noexcept nogil:
    cdef Gray16Picture picture
    picture.pixels = &gray16[0, 0]
    picture.height, picture.width = gray16.shape[0], gray16.shape[1]
    return picture


cdef class Quantizer:
    """Quantization of a 16-bit gray picture; see ``quantization.h``."""

    cdef QuantizeSettings settings

    def __init__(self, int smooth, int window, bint ratio, double ratio_of, double min_around,
                 double offset, double top):
        self.settings.smooth, self.settings.window, self.settings.ratio = smooth, window, ratio
        self.settings.ratio_of, self.settings.min_around = ratio_of, min_around
        self.settings.offset, self.settings.top = offset, top

    def rows(self, const uint32_t[:, ::1] sums, double scale, uint8_t[:, ::1] out, int first,
             int last, Scratch scratch):
        """Write rows first..last of the picture in levels."""
        cdef size_t needed = quantize_scratch(&self.settings, out.shape[1])
        cdef double *memory = <double *>scratch.of(needed * sizeof(double))
        with nogil:
            quantize_rows(&sums[0, 0], out.shape[0], out.shape[1], &self.settings, scale, first,
                          last, memory, &out[0, 0])


def summed_area_table(const uint16_t[:, ::1] gray16, uint32_t[:, ::1] sums):
    """Write the sums of all pixels above and left of each corner."""
    cdef Gray16Picture picture = gray16_picture(gray16)
    with nogil:
        summed_area(&picture, &sums[0, 0])


def level_counts(const uint8_t[:, ::1] gray, int cols, int patch_height, int patch_width,
                 int first, int last, int64_t[:, ::1] counts):
    """Write the histograms of patch rows first..last."""
    cdef int row, col
    with nogil:
        for row in range(first, last):
            for col in range(cols):
                count_levels(&gray[row * patch_height, col * patch_width], gray.shape[1],
                             patch_height, patch_width, &counts[row * cols + col, 0])


cdef PatchedPicture patched(const uint8_t[:, ::1] gray, int cols, int patch_height,
                            int patch_width) noexcept nogil:
    cdef PatchedPicture picture
    picture.pixels = &gray[0, 0]
    picture.height, picture.width, picture.cols = gray.shape[0], gray.shape[1], cols
    picture.patch_height, picture.patch_width = patch_height, patch_width
    return picture


def structure_sums(const uint8_t[:, ::1] gray, int cols, int patch_height, int patch_width,
                   int64_t[:, ::1] sums, int first, int last, Scratch scratch):
    """Write the sums of patch rows first..last."""
    cdef PatchedPicture picture = patched(gray, cols, patch_height, patch_width)
    cdef size_t needed = structure_scratch(&picture)
    cdef int32_t *memory = <int32_t *>scratch.of(needed * sizeof(int32_t))
    with nogil:
        structure_rows(&picture, first, last, memory, &sums[0, 0])


def gradient_sums(const uint16_t[:, ::1] gray16, int cols, int patch_height, int patch_width,
                  int box, int64_t[:, ::1] sums, int first, int last, Scratch scratch):
    """Write the sums of patch rows first..last."""
    cdef GradientPatches patches
    patches.picture = gray16_picture(gray16)
    patches.cols, patches.box = cols, box
    patches.patch_height, patches.patch_width = patch_height, patch_width
    cdef size_t needed = gradient_scratch(&patches)
    cdef double *memory = <double *>scratch.of(needed * sizeof(double))
    with nogil:
        gradient_rows(&patches, first, last, memory, &sums[0, 0])


def difference_sums(const uint8_t[:, :, ::1] frame, const int64_t[::1] rows, int cols,
                    const int32_t[::1] lags, int64_t[:, :, ::1] sums):
    """Write the sums of these rows."""
    cdef AreaFrame view = area_frame(frame)
    cdef DetailRows detail
    detail.frame, detail.rows = &view, &rows[0]
    detail.cols, detail.count, detail.lags = cols, lags.shape[0], &lags[0]
    with nogil:
        detail_rows(&detail, rows.shape[0], &sums[0, 0, 0])


def curvature_sums(const uint16_t[:, ::1] gray16, int cols, int patch_height, int patch_width,
                   const int32_t[::1] lags, int64_t[:, ::1] sums, int first, int last,
                   Scratch scratch):
    """Write the sums of patch rows first..last."""
    cdef CurvaturePatches patches
    patches.picture = gray16_picture(gray16)
    patches.cols, patches.patch_height, patches.patch_width = cols, patch_height, patch_width
    cdef size_t needed = curvature_scratch(&patches, lags.shape[0])
    cdef uint32_t *memory = <uint32_t *>scratch.of(needed * sizeof(uint32_t))
    with nogil:
        curvature_rows(&patches, &lags[0], lags.shape[0], first, last, memory, &sums[0, 0])


def box_sums(const uint8_t[:, :, ::1] frame, const int64_t[:, ::1] rows,
             const int64_t[:, ::1] columns, int64_t[:, :, ::1] sums, int first, int last,
             Scratch scratch):
    """Write the sums of ranges first..last of the rows, each with all ranges of the columns."""
    cdef AreaFrame view = area_frame(frame)
    cdef uint16_t *memory = <uint16_t *>scratch.of(boxes_scratch(&view) * sizeof(uint16_t))
    with nogil:
        boxes_rows(&view, &rows[0, 0], &columns[0, 0], columns.shape[0], first, last, memory,
                   &sums[0, 0, 0])


def line_sums(const uint8_t[:, ::1] gray, int cols, int patch_height, int patch_width, int middle,
              const int32_t[::1] samples, int64_t[:, :, ::1] sums, int first, int last,
              Scratch scratch):
    """Write the sums of patch rows first..last."""
    cdef PatchedPicture picture = patched(gray, cols, patch_height, patch_width)
    cdef LineKinds kinds
    kinds.middle, kinds.count, kinds.samples = middle, samples.shape[0], &samples[0]
    cdef size_t needed = lines_scratch(&picture, &kinds)
    cdef int16_t *memory = <int16_t *>scratch.of(needed * sizeof(int16_t))
    with nogil:
        lines_rows(&picture, &kinds, first, last, memory, &sums[0, 0, 0])


def nearest_counts(const uint8_t[:, ::1] gray, int cols, int patch_height, int patch_width,
                   const int32_t[:, ::1] moves, int reach, bint across_patches,
                   int64_t[:, ::1] counts, int first, int last, Scratch scratch):
    """Write the histograms of patch rows first..last."""
    cdef PatchedPicture picture = patched(gray, cols, patch_height, patch_width)
    cdef NearestPoints points
    points.points, points.reach, points.across_patches = moves.shape[0], reach, across_patches
    points.moves = &moves[0, 0]
    cdef uint8_t *memory = <uint8_t *>scratch.of(nearest_scratch(&picture, &points))
    with nogil:
        nearest_rows(&picture, &points, first, last, memory, &counts[0, 0])


cdef class MatchKernel:
    """How two views are matched block by block; see ``match.h``."""

    cdef MatchSettings settings

    def __init__(self, int smallest, int count, int block, int zero, int texture,
                 int uniqueness):
        self.settings.smallest, self.settings.count = smallest, count
        self.settings.block, self.settings.zero = block, zero
        self.settings.texture, self.settings.uniqueness = texture, uniqueness

    def disparities(self, const uint8_t[:, ::1] left, const uint8_t[:, ::1] right,
                    const uint8_t[:, ::1] wanted, int top, int bottom, int first, int last,
                    Scratch scratch, int16_t[:, ::1] out):
        """Write the disparities of the wanted pixels in rows top..bottom, columns first..last."""
        cdef MatchViews views
        views.left, views.right, views.wanted = &left[0, 0], &right[0, 0], &wanted[0, 0]
        views.width = left.shape[1]
        views.top, views.bottom, views.first, views.last = top, bottom, first, last
        cdef size_t needed = match_scratch(&self.settings, last - first)
        cdef uint16_t *memory = <uint16_t *>scratch.of(needed * sizeof(uint16_t))
        with nogil:
            match_views(&views, &self.settings, memory, &out[0, 0])


def row_marks(const uint8_t[:, ::1] gray, const uint64_t[:, ::1] weights, int lag, int largest,
              uint64_t[:, ::1] hashes, uint64_t[:, :, ::1] signs):
    """Write the hashes of all rows, and the signs of their differences."""
    cdef MarksKinds kinds
    cdef int row
    kinds.pieces, kinds.words, kinds.tiles = weights.shape[0], weights.shape[1], signs.shape[2]
    kinds.weights, kinds.lag, kinds.largest = &weights[0, 0], lag, largest
    with nogil:
        for row in range(gray.shape[0]):
            marks_row(&gray[row, 0], &kinds, &hashes[row, 0], &signs[0, row, 0], &signs[1, row, 0])


def sign_counts(const uint64_t[:, :, ::1] signs, const uint64_t[:, :, :, ::1] others,
                int64_t[:, ::1] counts):
    """Count where the signs of each other picture are alike, and where they are opposite."""
    cdef Py_ssize_t half = signs.shape[1] * signs.shape[2]
    cdef int other
    with nogil:
        for other in range(others.shape[0]):
            marks_counts(&signs[0, 0, 0], &others[other, 0, 0, 0], half, &counts[other, 0])
