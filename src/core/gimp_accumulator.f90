!> Sums in a fixed order with a carry (Neumaier 1974): thousands of blocks add up to round-off of the result, not of the count
module gimp_accumulator
  use gimp_kinds, only: dp
  implicit none(type, external)
  private
  public :: add_to, block_sum

contains

  !> total + carry grows by value; the sum is total + carry
  pure elemental subroutine add_to(total, carry, value)
    real(dp), intent(inout) :: total, carry
    real(dp), intent(in) :: value
    real(dp) :: t
    t = total + value
    if (abs(total) >= abs(value)) then
      carry = carry + ((total - t) + value)
    else
      carry = carry + ((value - t) + total)
    end if
    total = t
  end subroutine add_to

  !> Sum of the values of all blocks, in their order
  pure real(dp) function block_sum(values)
    real(dp), intent(in) :: values(:)
    real(dp) :: total, carry
    integer :: k
    total = 0.0_dp
    carry = 0.0_dp
    do k = 1, size(values)
      call add_to(total, carry, values(k))
    end do
    block_sum = total + carry
  end function block_sum

end module gimp_accumulator
