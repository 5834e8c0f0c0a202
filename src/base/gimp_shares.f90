!> Shares of a list that is dealt out in order: as equal as whole items allow, some empty when there are more shares than items
module gimp_shares
  use gimp_common_kinds, only: i8
  implicit none(type, external)
  private
  public :: share_t, items_of_share

  !> One share of several; unless said otherwise the whole
  type :: share_t
    integer :: number = 0 !! from 0
    integer :: shares = 1
  end type share_t

contains

  !> First and last of the n items that belong to a share; the last is before the first when there is none
  pure function items_of_share(share, n) result(bounds)
    type(share_t), intent(in) :: share
    integer(i8), intent(in) :: n
    integer(i8) :: bounds(2)
    bounds = [items_before(share%number) + 1, items_before(share%number + 1)]
  contains
    !> floor(n number/shares); the product might be too large
    pure integer(i8) function items_before(number)
      integer, intent(in) :: number
      items_before = n/share%shares*number + modulo(n, int(share%shares, i8))*number/share%shares
    end function items_before
  end function items_of_share

end module gimp_shares
