!> The loops that are timed. A file of their own: called from another one, they can be neither inlined nor left out.
module gimp_roofline_kernels
  use, intrinsic :: iso_fortran_env, only: real64, real32, int64
  implicit none(type, external)
  private
  public :: fma_double, fma_single, triad, update

contains

  !> Twelve independent chains of x = x*b + c in every lane: enough for two pipes of four cycles; 2*12*8*100 flops a sweep
  pure subroutine fma_double(x, sweeps, b, c)
    integer, parameter :: wp = real64, w = 8
    include "fma_chains.inc"
  end subroutine fma_double

  !> The same in single precision: 2*12*16*100 flops a sweep
  pure subroutine fma_single(x, sweeps, b, c)
    integer, parameter :: wp = real32, w = 16
    include "fma_chains.inc"
  end subroutine fma_single

  !> a = b + q*c as in STREAM, q alternately 2 and 1 so that no sweep can be left out; 24 bytes an element are counted
  pure subroutine triad(n, a, b, c, sweeps)
    integer(int64), intent(in) :: n, sweeps
    real(real64), intent(inout) :: a(n)
    real(real64), intent(in) :: b(n), c(n)
    real(real64) :: q
    integer(int64) :: i, sweep
    q = 1.0_real64
    do sweep = 1, sweeps
      q = 3.0_real64 - q
      !$omp simd
      do i = 1, n
        a(i) = b(i) + q*c(i)
      end do
    end do
  end subroutine triad

  !> a = q*a + c in place, what a particle pass does to the state; 16 bytes an element are counted
  pure subroutine update(n, a, q, c, sweeps)
    integer(int64), intent(in) :: n, sweeps
    real(real64), intent(inout) :: a(n)
    real(real64), intent(in) :: q, c
    integer(int64) :: i, sweep
    do sweep = 1, sweeps
      !$omp simd
      do i = 1, n
        a(i) = q*a(i) + c
      end do
    end do
  end subroutine update

end module gimp_roofline_kernels
