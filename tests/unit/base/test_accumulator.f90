!> Sums in a fixed order: to round-off of the result, and the same on any number of threads
program test_accumulator
  use gimp_common_kinds, only: dp
  use gimp_accumulator, only: block_sum, column_sums
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  use omp_lib, only: omp_set_num_threads
  implicit none(type, external)

  call begin_suite("accumulator")
  call test_carry()
  call test_columns()
  call end_suite()

contains

  !> Large terms that cancel leave the small ones
  subroutine test_carry()
    real(dp) :: values(2, 301)
    integer :: k
    real(dp) :: sums(2)
    values(1, :) = [(1.0e-3_dp, k=1, 301)]
    values(1, 1:300:3) = 1.0e16_dp
    values(1, 2:300:3) = -1.0e16_dp
    values(2, :) = 1.0_dp
    call column_sums(values, sums)
    call check(real(block_sum(values(1, :)), dp), 0.101_dp, 1.0e-15_dp, "small terms survive in a sum")
    call check(real(sums(1), dp), 0.101_dp, 1.0e-15_dp, "and in sums of columns")
    call check(real(sums(2), dp), 301.0_dp, 0.0_dp, "every column counts once")
    call column_sums(values(:, :0), sums)
    call check_true(all(sums == 0.0_dp), "no column: zero")
  end subroutine test_carry

  subroutine test_columns()
    real(dp) :: values(3, 1000), sums(3), first(3)
    integer :: k, threads
    do k = 1, 1000
      values(:, k) = [sin(1.0_dp*k), exp(0.02_dp*k), 1.0_dp/k]
    end do
    do threads = 1, 4
      call omp_set_num_threads(threads)
      call column_sums(values, sums)
      if (threads == 1) first = sums
      call check_true(all(sums == first), "the same bits on "//text_of(threads)//" threads")
    end do
  end subroutine test_columns

end program test_accumulator
