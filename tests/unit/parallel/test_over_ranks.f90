!> What all ranks have in common: sums without an order, largest reals, texts and errors of one rank
program test_over_ranks
  use gimp_common_kinds, only: dp, i8
  use gimp_text, only: text_of
  use gimp_error, only: error_t, raise
  use gimp_ranks, only: this_rank, ranks, backend, start_ranks, end_ranks
  use gimp_over_ranks, only: sum_columns, sum_of, sum_counts, largest_reals, smallest_reals, largest_count, any_rank, share_text, &
                             share_error, share_reals
  use gimp_check, only: begin_suite, suite_failed, check, check_true
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan, ieee_negative_inf, ieee_is_nan, ieee_copy_sign
  use omp_lib, only: omp_set_num_threads
  implicit none(type, external)

  call start_ranks()
  call begin_suite("over ranks, "//trim(backend)//", "//text_of(this_rank)//" of "//text_of(ranks))
  call test_sums()
  call test_counts()
  call test_largest()
  call test_not_numbers()
  call test_reals()
  call test_texts()
  call test_errors()
  call end_ranks(merge(1, 0, any_rank(suite_failed())))

contains

  !> Columns of blocks, dealt out to ranks in three ways and added on one or three threads
  subroutine test_sums()
    integer, parameter :: n = 2000
    real(dp) :: values(3, n), sums(3), expected(3), none(3, 0)
    integer :: k, first, last
    values = reshape([([sin(1.0_dp*k), exp(0.02_dp*k), (-1.0_dp)**k*1.0e16_dp + k], k=1, n)], [3, n])
    expected = [sin(0.5_dp*n)*sin(0.5_dp*(n + 1))/sin(0.5_dp), exp(0.02_dp)*(exp(0.02_dp*n) - 1)/(exp(0.02_dp) - 1), n*(n + 1.0_dp)/2]
    first = 1 + n*this_rank/ranks
    last = n*(this_rank + 1)/ranks
    call sum_columns(values(:, first:last), sums)
    call check(sums(1), expected(1), 1.0e-12_dp, "sum of sines") ! the terms themselves are rounded, as is the formula
    call check(sums(2)/expected(2), 1.0_dp, 1.0e-13_dp, "sum of powers")
    call check(sums(3), expected(3), 0.0_dp, "sum of what nearly cancels")
    expected = sums
    call omp_set_num_threads(3)
    call sum_columns(values(:, first:last), sums)
    call omp_set_num_threads(1)
    call check_true(all(sums == expected), "the same bits on three threads")
    if (this_rank == ranks - 1) then
      call sum_columns(values(:, n:1:-1), sums)
    else
      call sum_columns(none, sums)
    end if
    call check_true(all(sums == expected), "the same bits when one rank has all, backwards")
    call check(sum_of(values(1, first:last)), expected(1), 0.0_dp, "the sum of one quantity")
    call sum_columns(none, sums)
    call check_true(all(sums == 0), "nothing anywhere: zero")
  end subroutine test_sums

  subroutine test_counts()
    call check_true(sum_counts(2_i8**40 + this_rank) == 2_i8**40*ranks + ranks*(ranks - 1)/2, "counts beyond 32 bits")
    call check_true(largest_count(-2_i8**40 - this_rank) == -2_i8**40, "the largest of negative counts")
    call check_true(any_rank(this_rank == ranks - 1), "on the last rank only")
    call check_true(.not. any_rank(.false.), "nowhere")
  end subroutine test_counts

  !> Reals of both signs, zeros, and the smallest and largest there are; the last rank has all that is largest
  subroutine test_largest()
    real(dp) :: values(6), smallest(6)
    integer :: r
    r = ranks - 1 - this_rank
    values = [-1.0e-300_dp*(1 + r), -3.0_dp - r, 2.5_dp - 10*r, -tiny(1.0_dp)*r, huge(1.0_dp)/(1 + r), 10.0_dp**(-r)]
    smallest = values
    call largest_reals(values)
    call check_true(all(values == [-1.0e-300_dp, -3.0_dp, 2.5_dp, 0.0_dp, huge(1.0_dp), 1.0_dp]), "largest reals")
    call smallest_reals(smallest)
    r = ranks - 1
    call check_true(all(smallest == [-1.0e-300_dp*(1 + r), -3.0_dp - r, 2.5_dp - 10*r, -tiny(1.0_dp)*r, huge(1.0_dp)/(1 + r), 10.0_dp**(-r)]), &
                    "smallest reals")
  end subroutine test_largest

  !> One rank has what is not a number, of either sign: all get it, from the largest and from the smallest
  subroutine test_not_numbers()
    real(dp) :: values(4), smallest(4)
    values = [1.0_dp, -1.0_dp, huge(1.0_dp), ieee_value(1.0_dp, ieee_negative_inf)]
    if (this_rank == ranks - 1) values(1:3) = ieee_value(1.0_dp, ieee_quiet_nan)
    if (this_rank == ranks - 1) values(2) = ieee_copy_sign(values(2), -1.0_dp) ! as processors make it
    smallest = values
    call largest_reals(values)
    call check_true(all(ieee_is_nan(values(1:3))), "not a number is the largest of all")
    call check_true(values(4) < -huge(1.0_dp), "minus infinity is not larger than itself")
    call smallest_reals(smallest)
    call check_true(all(ieee_is_nan(smallest(1:3))), "and the smallest")
    call check_true(smallest(4) < -huge(1.0_dp), "as infinity is not smaller")
  end subroutine test_not_numbers

  subroutine test_reals()
    real(dp) :: values(2)
    integer :: root
    do root = 0, ranks - 1
      values = [-1.5_dp*this_rank, 1.0e-310_dp*(1 + this_rank)]
      call share_reals(root, values)
      call check_true(all(values == [-1.5_dp*root, 1.0e-310_dp*(1 + root)]), "reals of one rank")
    end do
  end subroutine test_reals

  !> Of every length about that of a word, with line ends, empty, none
  subroutine test_texts()
    character(len=*), parameter :: letters = "one"//new_line("a")//" two  three four "
    character(len=:), allocatable :: text
    integer :: root, n
    do root = 0, ranks - 1
      do n = 0, len(letters)
        text = "mine"
        if (this_rank == root) text = letters(:n)
        call share_text(root, text)
        call check(text//"|", letters(:n)//"|", "the text of rank "//text_of(root))
        call check_true(len(text) == n, "its length")
      end do
    end do
    deallocate (text)
    if (this_rank == 0) text = repeat("long ", 10000)
    call share_text(0, text)
    call check_true(text == repeat("long ", 10000), "a long text, where there was none")
    if (this_rank == ranks - 1) deallocate (text)
    call share_text(ranks - 1, text)
    if (this_rank /= ranks - 1) call check(text, "", "no text at all")
  end subroutine test_texts

  !> On no rank, on one, on several: all know that of the lowest
  subroutine test_errors()
    type(error_t), allocatable :: error
    integer :: r, most
    call share_error(error)
    call check_true(.not. allocated(error), "no error")
    most = 10 + this_rank
    call share_error(error, most)
    call check_true(.not. allocated(error) .and. most == 9 + ranks, "no error, and the largest number")
    do r = 0, ranks - 1
      if (allocated(error)) deallocate (error)
      if (this_rank == r) call raise(error, "wrong on rank "//text_of(r))
      call share_error(error)
      call check_true(allocated(error), "all have the error")
      if (allocated(error)) call check(error%message, "wrong on rank "//text_of(r), "the error of one rank")
      deallocate (error)
      if (this_rank >= r) call raise(error, "wrong on rank "//text_of(this_rank)//repeat(", very", this_rank))
      call share_error(error)
      call check_true(allocated(error), "all have one error")
      if (allocated(error)) call check(error%message, "wrong on rank "//text_of(r)//repeat(", very", r), "the error of the lowest rank")
      most = -abs(this_rank - r)
      call share_error(error, most)
      call check_true(most == 0, "the largest number comes with an error too")
    end do
  end subroutine test_errors

end program test_over_ranks
