!> Sums in a fixed order with a carry (Neumaier 1974): thousands of blocks add up to round-off of the result, not of the count
module gimp_accumulator
  use gimp_common_kinds, only: dp
  implicit none(type, external)
  private
  public :: add_to, block_sum, column_sums

  integer, parameter :: batch = 64 !! columns that are added by one thread
  integer, parameter :: few = 8 !! batches that are not worth waking other threads for

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

  !> The sum of all columns (of blocks, say): batches of columns in parallel, then the batches in their order. Batches do not
  !> depend on the number of threads, nor does the sum.
  subroutine column_sums(values, sums)
    real(dp), intent(in) :: values(:, :) !! (quantity, column)
    real(dp), intent(out) :: sums(:) !! (quantity)
    real(dp), allocatable :: part(:, :), carry(:, :)
    real(dp) :: rest(size(sums))
    integer :: k, b, batches
    batches = (size(values, 2) + batch - 1)/batch
    allocate (part(size(sums), batches), carry(size(sums), batches), source=0.0_dp)
    !$omp parallel do schedule(static) private(k) if(batches > few)
    do b = 1, batches
      do k = (b - 1)*batch + 1, min(b*batch, size(values, 2))
        call add_to(part(:, b), carry(:, b), values(:, k))
      end do
    end do
    !$omp end parallel do
    sums = 0.0_dp
    rest = 0.0_dp
    do b = 1, batches
      call add_to(sums, rest, part(:, b))
      call add_to(sums, rest, carry(:, b))
    end do
    sums = sums + rest
  end subroutine column_sums

end module gimp_accumulator
