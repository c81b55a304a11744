/* Kernels that a C++ compiler and CUDA's take alike.
 *
 * Blocks of HF_THREADS threads run in any order. HF_EACH(t) is what every thread t of a block does;
 * HF_WAIT parts what they have to end before any of them goes on. In C++ the threads of a block
 * follow one another, and so do the blocks. HF_CALLED is a function that is called, HF_FUNCTION one
 * that is a part of what calls it. Every operation is one that IEEE 754 defines; none is
 * fused but by a call of fma, so that both compilers give the same bits.
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
#define HF_WAIT __syncthreads()
#define HF_EACH(t) for (int t = threadIdx.x, hf_once = 1; hf_once; hf_once = 0)
#define HF_BLOCK ((hf_int)blockIdx.x)
#define HF_BLOCKS ((hf_int)gridDim.x)
#ifndef INFINITY
#define INFINITY __longlong_as_double(0x7ff0000000000000LL)
#endif
#ifndef NAN
#define NAN __longlong_as_double(0x7ff8000000000000LL)
#endif

HF_FUNCTION uint64_t hf_bits(double x) { return (uint64_t)__double_as_longlong(x); }
HF_FUNCTION double hf_from_bits(uint64_t x) { return __longlong_as_double((long long)x); }
HF_FUNCTION void hf_add(hf_bits64 *to, hf_bits64 what) { atomicAdd(to, what); }
HF_FUNCTION void hf_most(hf_bits64 *to, hf_bits64 what)
{
    if (what > *(volatile hf_bits64 *)to) atomicMax(to, what);
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
#define HF_WAIT
#define HF_EACH(t) for (int t = 0; t < HF_THREADS; t++)
#define HF_BLOCK hf_block
#define HF_BLOCKS hf_blocks

static thread_local hf_int hf_block = 0, hf_blocks = 1;
extern "C" void hf_on(hf_int block, hf_int blocks) { hf_block = block; hf_blocks = blocks; }

HF_FUNCTION uint64_t hf_bits(double x) { uint64_t b; std::memcpy(&b, &x, 8); return b; }
HF_FUNCTION double hf_from_bits(uint64_t x) { double b; std::memcpy(&b, &x, 8); return b; }
HF_FUNCTION void hf_add(hf_bits64 *to, hf_bits64 what) { *to += what; }
HF_FUNCTION void hf_most(hf_bits64 *to, hf_bits64 what) { if (what > *to) *to = what; }

#endif
