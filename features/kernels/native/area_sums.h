/* How the rows, then the columns, of a frame are added up to those of a smaller picture. Included
 * once for each kind of number, which names it all:
 *
 * SUMS_NAME(name)  what it is called
 * SUMS_TABLE       the type of a table
 * SUMS_VALUE       the type of weights and sums
 * SUMS_LANE        the same, in which a sum nobody looks at may run over */

/* Which input rows (or columns) make one output row: those from `source`, one for each weight. */
typedef struct {
    const int32_t *first;     /* [outputs + 1]: where an output's weights begin */
    const int32_t *source;    /* [outputs]: its first input */
    const SUMS_VALUE *weight; /* [all weights] */
} SUMS_TABLE;

/* Add up the frame's rows that make row y of the picture. Mostly those are a part of one, two or
 * three whole ones, which are added as whole numbers, and a part of the last: one pass. */
TOKT_BODY void SUMS_NAME(add_rows)(const AreaFrame *frame, const SUMS_TABLE *rows, int y,
                                   SUMS_VALUE *TOKT_RESTRICT sums) {
    const SUMS_VALUE *weight = rows->weight + rows->first[y];
    int n = frame->width * frame->channels, count = rows->first[y + 1] - rows->first[y];
    const uint8_t *TOKT_RESTRICT a = frame->pixels + rows->source[y] * frame->stride;
    SUMS_VALUE part = weight[0], last = weight[count - 1];
    if (count == 4 && weight[1] == weight[2]) {
        const uint8_t *TOKT_RESTRICT b = a + frame->stride, *TOKT_RESTRICT c = b + frame->stride;
        const uint8_t *TOKT_RESTRICT d = c + frame->stride;
        SUMS_VALUE whole = weight[1];
        for (int x = 0; x < n; x++)
            sums[x] = part * (SUMS_VALUE)a[x] + whole * (SUMS_VALUE)(b[x] + c[x]) +
                      last * (SUMS_VALUE)d[x];
    } else if (count == 5 && weight[1] == weight[2] && weight[2] == weight[3]) {
        const uint8_t *TOKT_RESTRICT b = a + frame->stride, *TOKT_RESTRICT c = b + frame->stride;
        const uint8_t *TOKT_RESTRICT d = c + frame->stride, *TOKT_RESTRICT e = d + frame->stride;
        SUMS_VALUE whole = weight[1];
        for (int x = 0; x < n; x++)
            sums[x] = part * (SUMS_VALUE)a[x] + whole * (SUMS_VALUE)(b[x] + c[x] + d[x]) +
                      last * (SUMS_VALUE)e[x];
    } else {
        for (int x = 0; x < n; x++) sums[x] = part * (SUMS_VALUE)a[x];
        for (int row = 1; row < count; row++) {
            const uint8_t *TOKT_RESTRICT in = a + row * frame->stride;
            SUMS_VALUE more = weight[row];
            for (int x = 0; x < n; x++) sums[x] += more * (SUMS_VALUE)in[x];
        }
    }
}

/* Add up the columns of `sums` that make each pixel of the picture's row. What is needed next of
 * the frame, the rows of the picture's row `next`, is asked for meanwhile: this loop computes while
 * memory could deliver. */
TOKT_BODY void SUMS_NAME(add_columns)(const AreaFrame *frame, const SUMS_TABLE *rows, int next,
                                      const SUMS_TABLE *columns, int width, const SUMS_VALUE *sums,
                                      SUMS_VALUE *TOKT_RESTRICT out) {
    int channels = frame->channels;
    const uint8_t *ahead = frame->pixels + rows->source[next] * frame->stride;
    ptrdiff_t n_ahead = (rows->first[next + 1] - rows->first[next]) * frame->stride;
    for (int x = 0; x < width; x++) {
        if ((ptrdiff_t)x * AREA_CACHE_LINE < n_ahead)
            TOKT_PREFETCH(ahead + (ptrdiff_t)x * AREA_CACHE_LINE);
        const SUMS_VALUE *in = sums + (ptrdiff_t)columns->source[x] * channels;
        const SUMS_VALUE *weight = columns->weight + columns->first[x];
        int count = columns->first[x + 1] - columns->first[x];
        if (channels == 1) {
            SUMS_VALUE sum = 0;
            for (int i = 0; i < count; i++) sum += weight[i] * in[i];
            out[x] = sum;
            continue;
        }
        /* Blue, green and red go side by side; the fourth value is the next pixel's. */
#if defined(__GNUC__)
        typedef SUMS_LANE pixel __attribute__((vector_size(16), aligned(4), may_alias));
        pixel sum = {0};
        for (int i = 0; i < count; i++) sum += (SUMS_LANE)weight[i] * *(const pixel *)(in + 3 * i);
        *(pixel *)(out + AREA_LANES * x) = sum;
#else
        SUMS_LANE sum[AREA_LANES] = {0, 0, 0, 0};
        for (int i = 0; i < count; i++)
            for (int lane = 0; lane < AREA_LANES; lane++)
                sum[lane] += (SUMS_LANE)weight[i] * (SUMS_LANE)in[3 * i + lane];
        memcpy(out + AREA_LANES * x, sum, sizeof sum);
#endif
    }
}

#undef SUMS_NAME
#undef SUMS_TABLE
#undef SUMS_VALUE
#undef SUMS_LANE
