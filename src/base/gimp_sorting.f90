!> Sorting of long integers: least-significant-digit radix sort, stable
module gimp_sorting
  use gimp_common_kinds, only: i8
  implicit none(type, external)
  private
  public :: sort_order, rank_keys

contains

  !> The stable order in which `key` is ascending: key(order(1)) <= key(order(2)) <= ...
  !> Bytes that all keys share are skipped, so that nearby keys cost few passes.
  subroutine sort_order(key, order)
    integer(i8), intent(in) :: key(:)
    integer, allocatable, intent(out) :: order(:)
    integer, allocatable :: other(:)
    integer(i8) :: varies, digit
    integer :: count(0:255), n, byte, i, k, next
    n = size(key)
    allocate (order(n), other(n))
    order = [(i, i=1, n)]
    if (n < 2) return
    varies = 0
    do i = 2, n
      varies = ior(varies, ieor(key(i), key(1)))
    end do
    do byte = 0, 7
      if (iand(shiftr(varies, 8*byte), 255_i8) == 0) cycle
      count = 0
      do i = 1, n
        digit = iand(shiftr(key(i), 8*byte), 255_i8)
        count(digit) = count(digit) + 1
      end do
      next = 1
      do k = 0, 255
        i = count(k)
        count(k) = next
        next = next + i
      end do
      do i = 1, n
        digit = iand(shiftr(key(order(i)), 8*byte), 255_i8)
        other(count(digit)) = order(i)
        count(digit) = count(digit) + 1
      end do
      order = other
    end do
  end subroutine sort_order

  !> The distinct keys in ascending order, and the place of every key among them
  subroutine rank_keys(key, distinct, rank)
    integer(i8), intent(in) :: key(:)
    integer(i8), allocatable, intent(out) :: distinct(:)
    integer, allocatable, intent(out) :: rank(:) !! distinct(rank(i)) = key(i)
    integer, allocatable :: order(:)
    integer :: i, n
    call sort_order(key, order)
    allocate (rank(size(key)), distinct(size(key)))
    n = 0
    do i = 1, size(key)
      if (n == 0) then
        n = 1
      else if (distinct(n) /= key(order(i))) then
        n = n + 1
      end if
      distinct(n) = key(order(i))
      rank(order(i)) = n
    end do
    distinct = distinct(:n)
  end subroutine rank_keys

end module gimp_sorting
