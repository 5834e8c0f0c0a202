!> What all ranks have in common: sums in which order means nothing, largest values, words and errors of one rank for all.
!> With one rank each procedure gives what it was given.
module gimp_over_ranks
  use gimp_common_kinds, only: dp, i8
  use gimp_error, only: error_t, raise
  use gimp_exact_sum, only: words_of_sum, wide_sum_t, add_exactly, pack_sum, merge_sums, value_of_sum, pack_largest, packed_largest
  use gimp_ranks, only: this_rank, ranks, share_words, sum_words, largest_words, reduce_sums
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan, ieee_value, ieee_quiet_nan
  use omp_lib, only: omp_get_max_threads
  implicit none(type, external)
  private
  public :: sum_columns, sum_of, sum_counts, largest_reals, smallest_reals, largest_count, any_rank, share_text, share_error, share_reals, join_reals

  integer, parameter :: few = 512 !! columns that are not worth waking other threads for

contains

  !> Sums of all columns (of blocks, say) of all ranks, with the same bits in any order, and on the same way the largest of other
  !> values. Collective
  subroutine sum_columns(values, sums, largest)
    real(dp), intent(in), contiguous :: values(:, :) !! (quantity, column)
    real(dp), intent(out) :: sums(:) !! (quantity)
    real(dp), intent(inout), optional :: largest(:)
    integer(i8) :: words(words_of_sum, size(sums)), part(words_of_sum, size(sums))
    integer :: k, p, parts
    parts = merge(omp_get_max_threads(), 1, size(values, 2) > few)
    words = 0
    words(1, :) = -1
    !$omp parallel do schedule(static, 1) private(part) if(parts > 1)
    do p = 1, parts
      part = columns_between(values, 1 + int(size(values, 2)*int(p - 1, i8)/parts), int(size(values, 2)*int(p, i8)/parts))
      !$omp critical (merge_parts)
      call merge_sums(words, part)
      !$omp end critical (merge_parts)
    end do
    !$omp end parallel do
    if (ranks > 1) call reduce(words, largest)
    do k = 1, size(sums)
      sums(k) = value_of_sum(words(:, k))
    end do
  end subroutine sum_columns

  !> Merge exact sums and largest values of all ranks in one message
  subroutine reduce(words, largest)
    integer(i8), intent(inout) :: words(:, :) !! (words of a sum, sum)
    real(dp), intent(inout), optional :: largest(:)
    integer(i8), allocatable :: all(:, :)
    integer :: k, n, m
    n = size(words, 2)
    m = 0
    if (present(largest)) m = size(largest)
    allocate (all(words_of_sum, n + m))
    all(:, :n) = words
    if (m > 0) call plain_nan(largest)
    do k = 1, m
      all(:, n + k) = pack_largest(in_order(transfer(largest(k), 0_i8)))
    end do
    call reduce_sums(all)
    words = all(:, :n)
    do k = 1, m
      largest(k) = transfer(in_order(packed_largest(all(:, n + k))), largest(k))
    end do
  end subroutine reduce

  !> Exact sums of some columns
  pure function columns_between(values, first, last) result(words)
    real(dp), intent(in), contiguous :: values(:, :)
    integer, intent(in) :: first, last
    integer(i8) :: words(words_of_sum, size(values, 1))
    type(wide_sum_t) :: total
    integer :: k, c
    do k = 1, size(values, 1)
      total = wide_sum_t()
      do c = first, last
        call add_exactly(total, values(k, c))
      end do
      words(:, k) = pack_sum(total)
    end do
  end function columns_between

  !> The same of one quantity. Collective
  real(dp) function sum_of(values)
    real(dp), intent(in), contiguous :: values(:)
    real(dp) :: sums(1)
    call sum_columns(reshape(values, [1, size(values)]), sums)
    sum_of = sums(1)
  end function sum_of

  !> Sum of whole numbers. Collective
  integer(i8) function sum_counts(count)
    integer(i8), intent(in) :: count
    integer(i8) :: words(1)
    words = count
    if (ranks > 1) call sum_words(words)
    sum_counts = words(1)
  end function sum_counts

  !> Largest whole number. Collective
  integer(i8) function largest_count(count)
    integer(i8), intent(in) :: count
    integer(i8) :: words(1)
    words = count
    if (ranks > 1) call largest_words(words)
    largest_count = words(1)
  end function largest_count

  !> Whether it is so on any rank. Collective
  logical function any_rank(here)
    logical, intent(in) :: here
    any_rank = largest_count(merge(1_i8, 0_i8, here)) > 0
  end function any_rank

  !> Largest values over all ranks; one that is not a number is the largest of all. Collective
  subroutine largest_reals(values)
    real(dp), intent(inout) :: values(:)
    integer(i8) :: words(size(values))
    if (ranks == 1) return
    call plain_nan(values)
    words = in_order(transfer(values, words))
    call largest_words(words)
    values = transfer(in_order(words), values)
  end subroutine largest_reals

  !> What is not a number loses the sign that processors give it, which would decide whether it is the largest
  subroutine plain_nan(values)
    real(dp), intent(inout) :: values(:)
    where (ieee_is_nan(values)) values = ieee_value(values, ieee_quiet_nan)
  end subroutine plain_nan

  !> Smallest values over all ranks; one that is not a number is the smallest of all. Collective
  subroutine smallest_reals(values)
    real(dp), intent(inout) :: values(:)
    values = -values
    call largest_reals(values)
    values = -values
  end subroutine smallest_reals

  !> Bits of a real as a whole number in the same order, and back
  pure elemental integer(i8) function in_order(bits)
    integer(i8), intent(in) :: bits
    in_order = bits
    if (bits < 0) in_order = ieor(bits, huge(bits))
  end function in_order

  !> All get the reals of one rank. Collective
  subroutine share_reals(root, values)
    integer, intent(in) :: root
    real(dp), intent(inout) :: values(:)
    integer(i8) :: words(size(values))
    if (ranks == 1) return
    words = transfer(values, words)
    call share_words(root, words)
    values = transfer(words, values)
  end subroutine share_reals

  !> Reals that one rank knows, each, and the others have as zero: all get them, bit for bit. Collective
  subroutine join_reals(values)
    real(dp), intent(inout), contiguous :: values(:, :)
    integer(i8) :: words(size(values))
    if (ranks == 1) return
    words = transfer(values, words)
    call sum_words(words)
    values = reshape(transfer(words, values), shape(values))
  end subroutine join_reals

  !> All get the text of one rank. Collective
  subroutine share_text(root, text)
    integer, intent(in) :: root
    character(len=:), allocatable, intent(inout) :: text
    integer(i8) :: length(1)
    integer(i8), allocatable :: words(:)
    if (ranks == 1) return
    length = 0
    if (this_rank == root .and. allocated(text)) length = len(text)
    call share_words(root, length)
    allocate (words((length(1) + 7)/8), source=0_i8)
    if (this_rank == root .and. length(1) > 0) words = transfer(text//repeat(" ", 8), words, size(words))
    call share_words(root, words)
    if (this_rank == root) return
    text = transfer(words, repeat(" ", int(8*size(words))))
    text = text(:length(1))
  end subroutine share_text

  !> If any rank has an error all have the one of the lowest rank that has one. Collective
  subroutine share_error(error, largest)
    type(error_t), allocatable, intent(inout) :: error
    integer, intent(inout), optional :: largest !! a whole number, in: of this rank, out: the largest; it costs no message of its own
    character(len=:), allocatable :: message
    integer(i8) :: words(2)
    if (ranks == 1) return
    words = 0
    words(1) = -merge(int(this_rank, i8), int(ranks, i8), allocated(error))
    if (present(largest)) words(2) = largest
    call largest_words(words)
    if (present(largest)) largest = int(words(2))
    if (words(1) == -ranks) return
    message = ""
    if (allocated(error)) message = error%message
    call share_text(int(-words(1)), message)
    call raise(error, message)
  end subroutine share_error

end module gimp_over_ranks
