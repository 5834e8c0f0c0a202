!> Slabs: places 1, 2, ..., n of a list shared out in equal ranges, the first to rank 0. What ranks hold in any order is brought to
!> the slabs, and from there to a file in the order of places.
module gimp_slabs
  use, intrinsic :: iso_c_binding, only: c_loc, c_f_pointer
  use gimp_common_kinds, only: dp, i8
  use gimp_ranks, only: this_rank, ranks, words_before, exchange_words
  implicit none(type, external)
  private
  public :: slab_t, slab_of, delivery_t, plan_delivery, bring_to_slab, close_gaps

  !> Places of this rank
  type :: slab_t
    integer(i8) :: n = 0 !! of all ranks
    integer(i8) :: width = 0 !! of every rank but the last ones
    integer(i8) :: before = 0 !! of the ranks before
    integer(i8) :: mine = 0
  end type slab_t

  !> Who sends what to which slab: the same for every quantity
  type :: delivery_t
    type(slab_t) :: slab
    integer(i8), allocatable :: to_count(:), from_count(:) !! items for and from each rank
    integer(i8), allocatable :: place(:) !! in the slab, of each item that comes
  end type delivery_t

contains

  !> The slab of this rank, of n places
  type(slab_t) function slab_of(n) result(slab)
    integer(i8), intent(in) :: n
    slab%n = n
    slab%width = (n + ranks - 1)/ranks
    slab%before = min(n, this_rank*slab%width)
    slab%mine = min(n, slab%before + slab%width) - slab%before
  end function slab_of

  !> Put items in the order in which they are sent, and learn which come. Collective
  subroutine plan_delivery(slab, place, delivery, slot)
    type(slab_t), intent(in) :: slab
    integer(i8), intent(in) :: place(:, :) !! of each item in the whole list; 0: no item
    type(delivery_t), intent(out) :: delivery
    integer(i8), intent(out) :: slot(:, :) !! number of each item on its way, 0: no item
    integer(i8) :: next(0:ranks - 1)
    integer(i8), allocatable :: within(:)
    integer :: holder, i, k
    delivery%slab = slab
    allocate (delivery%to_count(0:ranks - 1), delivery%from_count(0:ranks - 1), source=0_i8)
    do k = 1, size(place, 2)
      do i = 1, size(place, 1)
        if (place(i, k) == 0) cycle
        holder = int((place(i, k) - 1)/slab%width)
        delivery%to_count(holder) = delivery%to_count(holder) + 1
      end do
    end do
    next = 0
    do holder = 1, ranks - 1
      next(holder) = next(holder - 1) + delivery%to_count(holder - 1)
    end do
    allocate (within(sum(delivery%to_count)))
    do k = 1, size(place, 2)
      do i = 1, size(place, 1)
        slot(i, k) = 0
        if (place(i, k) == 0) cycle
        holder = int((place(i, k) - 1)/slab%width)
        next(holder) = next(holder) + 1
        slot(i, k) = next(holder)
        within(next(holder)) = place(i, k) - holder*slab%width
      end do
    end do
    call exchange_words(delivery%to_count, within, delivery%from_count, delivery%place)
  end subroutine plan_delivery

  !> Bring a quantity of all items to the slabs. Collective
  subroutine bring_to_slab(delivery, values)
    type(delivery_t), intent(in) :: delivery
    real(dp), allocatable, intent(inout), target :: values(:, :) !! in: (component, item) in the order of slots; out: (component, place)
    integer(i8), allocatable, target :: came(:)
    integer(i8), target :: nothing(0)
    integer(i8), pointer, contiguous :: words(:)
    integer(i8) :: from_count(0:ranks - 1), k
    integer :: components
    components = size(values, 1)
    words => nothing
    if (size(values) > 0) call c_f_pointer(c_loc(values), words, [size(values, kind=i8)])
    call exchange_words(components*delivery%to_count, words, from_count, came)
    deallocate (values)
    allocate (values(components, delivery%slab%mine))
    do k = 1, size(delivery%place, kind=i8)
      values(:, delivery%place(k)) = transfer(came(components*(k - 1) + 1:components*k), values(:, 1))
    end do
  end subroutine bring_to_slab

  !> Places of items in the order of their numbers, where some numbers are missing. Collective
  subroutine close_gaps(largest, number, place)
    integer(i8), intent(in) :: largest !! number of all ranks
    integer(i8), intent(in) :: number(:, :) !! of each item, each only once; 0: no item
    integer(i8), intent(out) :: place(:, :) !! from 1; 0: no item
    type(delivery_t) :: delivery
    integer(i8), allocatable :: upto(:), answer(:), back(:)
    integer(i8) :: back_count(0:ranks - 1), before(1), k
    integer :: i, c
    call plan_delivery(slab_of(largest), number, delivery, place)
    allocate (upto(0:delivery%slab%mine), source=0_i8)
    upto(delivery%place) = 1
    do k = 1, delivery%slab%mine
      upto(k) = upto(k) + upto(k - 1)
    end do
    before = upto(delivery%slab%mine)
    call words_before(before)
    answer = upto(delivery%place) + before(1)
    call exchange_words(delivery%from_count, answer, back_count, back)
    do c = 1, size(place, 2)
      do i = 1, size(place, 1)
        if (place(i, c) > 0) place(i, c) = back(place(i, c))
      end do
    end do
  end subroutine close_gaps

end module gimp_slabs
