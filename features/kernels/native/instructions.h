/* One source, several instruction sets: the best the processor has is picked when a kernel runs.
 *
 * A build for the ship's PC must start on any x86-64 and still use what a newer one offers, so
 * nothing is compiled for the machine that builds. A kernel is written once as an inline body;
 * TOKT_VARIANTS makes one function of it for each level and one that calls the right one. No
 * variant may fuse a multiplication with an addition (the build passes -ffp-contract=off): the
 * results are the same bits on each of them. */
#ifndef TOKT_INSTRUCTIONS_H
#define TOKT_INSTRUCTIONS_H

#if defined(__GNUC__)
#define TOKT_PREFETCH(address) __builtin_prefetch(address, 0, 2)
#define TOKT_RESTRICT __restrict__
#define TOKT_BODY static inline __attribute__((always_inline))
#elif defined(_MSC_VER)
#define TOKT_PREFETCH(address) ((void)0)
#define TOKT_RESTRICT __restrict
#define TOKT_BODY static __forceinline
#else
#define TOKT_PREFETCH(address) ((void)0)
#define TOKT_RESTRICT
#define TOKT_BODY static inline
#endif

/* From the plainest up to what the platform's best processors have. */
enum { PLAIN = 0, AVX2 = 1, AVX512 = 2, NEON = 1 };

#if defined(__GNUC__) && defined(__x86_64__)

static const char *const instructions_names[] = {"plain", "avx2", "avx512"};

static int instructions_best(void) {
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
        __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512dq"))
        return AVX512;
    return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("popcnt") ? AVX2 : PLAIN;
}

static int instructions_used = PLAIN;

#define TOKT_AVX2 __attribute__((target("avx2,popcnt")))
#define TOKT_AVX512 \
    __attribute__((target("avx2,popcnt,avx512f,avx512vl,avx512bw,avx512dq,prefer-vector-width=512")))

#define TOKT_VARIANTS(name, declaration, arguments)                                          \
    static void name##_plain declaration { name##_body arguments; }                          \
    TOKT_AVX2 static void name##_avx2 declaration { name##_body arguments; }                 \
    TOKT_AVX512 static void name##_avx512 declaration { name##_body arguments; }             \
    static void name declaration {                                                           \
        if (instructions_used == AVX512)                                                     \
            name##_avx512 arguments;                                                         \
        else if (instructions_used == AVX2)                                                  \
            name##_avx2 arguments;                                                           \
        else                                                                                 \
            name##_plain arguments;                                                          \
    }

/* For short loops, which wider registers do not even fill. */
#define TOKT_VARIANTS_TO_AVX2(name, declaration, arguments)                                  \
    static void name##_plain declaration { name##_body arguments; }                          \
    TOKT_AVX2 static void name##_avx2 declaration { name##_body arguments; }                 \
    static void name declaration {                                                           \
        if (instructions_used >= AVX2)                                                       \
            name##_avx2 arguments;                                                           \
        else                                                                                 \
            name##_plain arguments;                                                          \
    }

#elif defined(__GNUC__) && defined(__aarch64__)

/* Every such processor has NEON: the plain variant is there to hold the other one against. clang
 * does not know the attribute, and makes both alike. */
static const char *const instructions_names[] = {"plain", "neon"};
static int instructions_best(void) { return NEON; }
static int instructions_used = PLAIN;

#if defined(__clang__)
#define TOKT_SCALAR
#else
#define TOKT_SCALAR __attribute__((optimize("no-tree-loop-vectorize", "no-tree-slp-vectorize")))
#endif

#define TOKT_VARIANTS(name, declaration, arguments)                                          \
    TOKT_SCALAR static void name##_plain declaration { name##_body arguments; }              \
    static void name##_neon declaration { name##_body arguments; }                           \
    static void name declaration {                                                           \
        if (instructions_used == NEON)                                                       \
            name##_neon arguments;                                                           \
        else                                                                                 \
            name##_plain arguments;                                                          \
    }
#define TOKT_VARIANTS_TO_AVX2(name, declaration, arguments) \
    TOKT_VARIANTS(name, declaration, arguments)

#else

static const char *const instructions_names[] = {"plain"};
static int instructions_best(void) { return PLAIN; }
static int instructions_used = PLAIN;
#define TOKT_VARIANTS(name, declaration, arguments) \
    static void name declaration { name##_body arguments; }
#define TOKT_VARIANTS_TO_AVX2(name, declaration, arguments) \
    TOKT_VARIANTS(name, declaration, arguments)

#endif

#endif
