!> Sums that do not depend on the order of their terms: same bits however many threads and ranks add them up.
!>
!> A sum is kept as whole numbers in bins of 32 bits: bin j counts multiples of 2^(32 j). Adding to bins is exact, so that order means nothing.
!> The four highest bins are kept of all that terms reach (an idea of Demmel & Nguyen 2015, with integers): at
!> least 84 bits from the leading one of the largest term, so that a sum is exact but for 2^-84 of that term for each of them.
module gimp_exact_sum
  use gimp_common_kinds, only: dp, i8
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan
  implicit none(type, external)
  private
  public :: words_of_sum, wide_sum_t, add_exactly, pack_sum, merge_sums, value_of_sum, pack_largest, packed_largest

  integer, parameter :: kept = 4 !! bins
  integer, parameter :: words_of_sum = kept + 1 !! number of the highest bin, then the bins from there down
  integer, parameter :: bins = 68 !! those of all finite numbers, 0 being that of the smallest
  integer, parameter :: lowest = 1074 !! 2^-lowest is the unit of bin 0
  integer(i8), parameter :: empty = -1 !! highest bin of a sum without terms
  integer(i8), parameter :: broken = bins + kept !! the same once a term was no finite number
  integer(i8), parameter :: largest = -2 !! marks a number of which the largest is wanted
  integer(i8), parameter :: digit = int(z"FFFFFFFF", i8)

  !> A sum under way in one thread
  type :: wide_sum_t
    integer(i8) :: top = empty
    integer(i8) :: bin(0:bins) = 0
  end type wide_sum_t

contains

  !> sum <- sum + value. All parts that are merged may have 2^31 terms together
  pure subroutine add_exactly(sum, value)
    type(wide_sum_t), intent(inout) :: sum
    real(dp), intent(in) :: value
    integer(i8) :: bits, m, way
    integer :: exponent, at, shift
    bits = transfer(value, bits)
    m = iand(bits, int(z"FFFFFFFFFFFFF", i8))
    exponent = int(ibits(bits, 52, 11))
    if (exponent == 0) then
      if (m == 0) return
      exponent = 1
    else
      m = ibset(m, 52)
    end if
    if (exponent == 2047) then
      sum%top = broken
      return
    end if
    at = (exponent - 1)/32
    shift = modulo(exponent - 1, 32)
    way = 1 - 2*ibits(bits, 63, 1)
    sum%bin(at) = sum%bin(at) + way*iand(shiftl(m, shift), digit)
    sum%bin(at + 1) = sum%bin(at + 1) + way*iand(shiftr(m, 32 - shift), digit)
    sum%bin(at + 2) = sum%bin(at + 2) + way*shiftr(shiftr(m, 32), 32 - shift)
    sum%top = max(sum%top, int(at + 2, i8))
  end subroutine add_exactly

  !> The highest bins, as ranks and threads hand them on
  pure function pack_sum(sum) result(words)
    type(wide_sum_t), intent(in) :: sum
    integer(i8) :: words(words_of_sum)
    integer :: k
    words = 0
    words(1) = sum%top
    if (sum%top == empty .or. sum%top == broken) return
    do k = 1, kept
      if (sum%top - k + 1 >= 0) words(1 + k) = sum%bin(sum%top - k + 1)
    end do
  end function pack_sum

  !> A number that travels among sums, though not its sum but the largest of all is wanted
  pure function pack_largest(number) result(words)
    integer(i8), intent(in) :: number
    integer(i8) :: words(words_of_sum)
    words = 0
    words(1) = largest
    words(2) = number
  end function pack_largest

  !> That number
  pure integer(i8) function packed_largest(words)
    integer(i8), intent(in) :: words(words_of_sum)
    packed_largest = words(2)
  end function packed_largest

  !> sums <- sums + more; of numbers packed with `pack_largest` the larger one
  pure subroutine merge_sums(sums, more)
    integer(i8), intent(inout) :: sums(:, :) !! (word, sum)
    integer(i8), intent(in) :: more(:, :)
    integer(i8) :: top, mine(kept), other(kept)
    integer :: k
    do k = 1, size(sums, 2)
      if (sums(1, k) == largest) then
        sums(2, k) = max(sums(2, k), more(2, k))
        cycle
      end if
      top = max(sums(1, k), more(1, k))
      mine = lowered(sums(:, k), top)
      other = lowered(more(:, k), top)
      sums(1, k) = top
      sums(2:, k) = mine + other
    end do
  end subroutine merge_sums

  !> The bins from `top` down of a sum whose highest is not above it
  pure function lowered(words, top) result(bin)
    integer(i8), intent(in) :: words(words_of_sum), top
    integer(i8) :: bin(kept)
    integer(i8) :: down
    bin = 0
    if (words(1) == empty .or. top == broken) return
    down = top - words(1)
    if (down < kept) bin(down + 1:) = words(2:words_of_sum - down)
  end function lowered

  !> The sum, rounded to within one unit in the last place; too large is infinite
  pure real(dp) function value_of_sum(words) result(value)
    integer(i8), intent(in) :: words(words_of_sum)
    integer(i8) :: bin(0:kept), way
    real(dp) :: high, low, next
    integer :: k, unit, down
    value = 0.0_dp
    if (words(1) == empty) return
    if (words(1) == broken) then
      value = ieee_value(value, ieee_quiet_nan)
      return
    end if
    bin = carried([0_i8, words(2:)])
    way = merge(-1_i8, 1_i8, bin(0) < 0)
    if (way < 0) bin = carried(-bin) ! a positive sum: its leading digit is no larger than the sum itself
    down = merge(128, 0, words(1) > bins/2) ! digits of a sum of huge numbers are kept from overflow
    unit = int(32*(words(1) + 1)) - lowest - down ! of bin(0)
    high = 0.0_dp
    low = 0.0_dp
    do k = 0, kept
      next = scale(real(bin(k), dp), unit - 32*k)
      value = high + next
      low = low + ((high - value) + next) ! |high| >= |next|, or high is zero
      high = value
    end do
    value = way*scale(high + low, down)
  end function value_of_sum

  !> Digits from 0 to 2^32 - 1 in all bins but the first, which is exact
  pure function carried(sums) result(bin)
    integer(i8), intent(in) :: sums(0:)
    integer(i8) :: bin(0:ubound(sums, 1))
    integer :: k
    bin = sums
    do k = ubound(bin, 1), 1, -1
      bin(k - 1) = bin(k - 1) + shifta(bin(k), 32)
      bin(k) = iand(bin(k), digit)
    end do
  end function carried

end module gimp_exact_sum
