/* Kernels that a C++ compiler and CUDA's take alike.
 *
 * Blocks of HF_THREADS threads run in any order. HF_OVER_THREADS, HF_OVER_BLOCKS and HF_OVER_ALL
 * share the numbers of a range among the threads of a block, the blocks, and the threads of all
 * blocks; hf_wait parts what the threads of a block have to end before any of them goes on; hf_add
 * and hf_most change an entry that others change. In C++ the threads of a block follow one another,
 * and so do the blocks. HF_CALLED is a function that is called, HF_FUNCTION one that is a part of
 * what calls it. Every operation is one that IEEE 754 defines; none is fused but by a call of fma,
 * so that both compilers give the same bits.
 */
#define HF_THREADS 128

typedef long hf_int;
static_assert(sizeof(hf_int) == 8, "a whole number has 64 bits");
typedef unsigned long long hf_bits64;

#if defined(__CUDACC__)

#if defined(__CUDACC_RTC__)
typedef unsigned char uint8_t;
typedef unsigned long long uint64_t;
#define UINT64_C(number) number##ULL
#else
#include <cstdint>
#endif
#define HF_FUNCTION static __device__ __forceinline__
#define HF_CALLED static __device__ __noinline__
#define HF_KERNEL extern "C" __global__ void __launch_bounds__(HF_THREADS)
#define HF_SHARED __shared__
#define HF_BLOCK ((hf_int)blockIdx.x)
#define HF_BLOCKS ((hf_int)gridDim.x)
#define HF_OVER_THREADS(k, first, last)                                                            \
    for (k = (first) + (hf_int)threadIdx.x; k < (last); k += HF_THREADS)
#define HF_OVER_ALL(k, first, last)                                                                \
    for (k = (first) + HF_BLOCK * HF_THREADS + (hf_int)threadIdx.x; k < (last);                    \
         k += HF_BLOCKS * HF_THREADS)
#ifndef INFINITY
#define INFINITY __longlong_as_double(0x7ff0000000000000LL)
#endif
#ifndef NAN
#define NAN __longlong_as_double(0x7ff8000000000000LL)
#endif

HF_FUNCTION uint64_t hf_bits(double x) { return (uint64_t)__double_as_longlong(x); }
HF_FUNCTION double hf_from_bits(uint64_t x) { return __longlong_as_double((long long)x); }
HF_FUNCTION void hf_wait() { __syncthreads(); }
HF_FUNCTION void hf_add(hf_int *to, hf_int k, hf_int n) { atomicAdd((hf_bits64 *)(to + k), (hf_bits64)n); }
HF_FUNCTION void hf_most(hf_int *to, hf_int k, double x)
{
    const hf_bits64 bits = hf_bits(x);
    if (bits > *(volatile hf_bits64 *)(to + k)) atomicMax((hf_bits64 *)(to + k), bits);
}

#else

#include <cmath>
#include <cstdint>
#include <cstring>
using std::ceil; using std::isfinite; using std::isnan; using std::fabs; using std::floor; using std::fma; using std::rint; using std::sqrt;

#define HF_FUNCTION static inline
#define HF_CALLED static inline
#define HF_KERNEL extern "C" void
#define HF_SHARED static thread_local
#define HF_BLOCK hf_block
#define HF_BLOCKS hf_blocks
#define HF_OVER_THREADS(k, first, last) for (k = (first); k < (last); k++)
#define HF_OVER_ALL HF_OVER_BLOCKS

static thread_local hf_int hf_block = 0, hf_blocks = 1;
extern "C" void hf_on(hf_int block, hf_int blocks) { hf_block = block; hf_blocks = blocks; }

HF_FUNCTION uint64_t hf_bits(double x) { uint64_t b; std::memcpy(&b, &x, 8); return b; }
HF_FUNCTION double hf_from_bits(uint64_t x) { double b; std::memcpy(&b, &x, 8); return b; }
HF_FUNCTION void hf_wait() {}
HF_FUNCTION void hf_add(hf_int *to, hf_int k, hf_int n) { to[k] += n; }
HF_FUNCTION void hf_most(hf_int *to, hf_int k, double x)
{
    const hf_int bits = (hf_int)hf_bits(x);
    if (bits > to[k]) to[k] = bits;
}

#endif

#define HF_OVER_BLOCKS(k, first, last) for (k = (first) + HF_BLOCK; k < (last); k += HF_BLOCKS)
