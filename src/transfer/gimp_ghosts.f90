!> Who is near: blocks of other ranks that reach nodes of this one (ghosts), further slots that images need, and which rank counts
!> which slot.
!>
!> Each rank tells the owners of the places around its blocks of them: whatever matters to a rank is told to it, and no list of all blocks
!> is needed. Places that images join are around each other.
module gimp_ghosts
  use gimp_kinds, only: wp, i8
  use gimp_grid, only: grid_t, block_key, block_at_key, block_of_node, canonical_node, has_images, nodes_per_block
  use gimp_blocks, only: block_table_t
  use gimp_images, only: related_blocks, related_along
  use gimp_patches, only: patches_t
  use gimp_hash_table, only: hash_table_t, clear_table, insert_key, find_key, list_keys
  use gimp_sorting, only: sort_order
  use gimp_ranks, only: this_rank, ranks, exchange_words
  use gimp_cuts, only: rank_of_key, is_mine
  use gimp_border, only: border_t
  implicit none(type, external)
  private
  public :: reach, find_ghosts, ranks_near_patch, add_related, book_slots, near_images

  integer, parameter :: reach = 2 !! blocks: pads of blocks farther apart have no node in common

contains

  !> Tell ranks of the blocks here that may matter to them, and hear of theirs. Collective
  subroutine find_ghosts(grid, patches, border, block_at, ghost_at)
    type(grid_t), intent(in) :: grid
    type(patches_t), intent(in) :: patches !! of a mesh
    type(border_t), intent(inout) :: border
    integer, intent(in) :: block_at(:, :)
    integer, allocatable, intent(out) :: ghost_at(:, :)
    integer(i8), allocatable :: told(:), heard(:), list(:)
    integer, allocatable :: to(:), order(:)
    integer(i8) :: to_count(0:ranks - 1), from_count(0:ranks - 1), i
    type(hash_table_t) :: mine
    integer :: b, r, n, value, near(ranks), found
    call clear_table(mine, size(block_at, 2))
    allocate (told(64), to(64))
    n = 0
    do b = 1, size(block_at, 2)
      call insert_key(mine, block_key(block_at(:, b)), b, value)
      if (grid%is_mesh) then
        call ranks_near_patch(patches, border%cut, block_at(1, b), near, found)
      else
        call ranks_near(grid, border%cut, block_at(:, b), near, found)
      end if
      do r = 1, found
        if (n == size(told)) then
          told = [told, told]
          to = [to, to]
        end if
        n = n + 1
        told(n) = block_key(block_at(:, b))
        to(n) = near(r)
      end do
    end do
    call sort_order(int(to(:n), i8), order)
    list = told(order)
    to_count = 0
    do r = 1, n
      to_count(to(r)) = to_count(to(r)) + 1
    end do
    call exchange_words(to_count, list, from_count, heard)
    allocate (ghost_at(3, size(heard)))
    if (allocated(border%ghost_rank)) deallocate (border%ghost_rank)
    allocate (border%ghost_rank(size(heard)))
    call clear_table(border%ghost_of, size(heard))
    n = 0
    i = 0
    do r = 0, ranks - 1
      do b = 1, int(from_count(r))
        i = i + 1
        if (.not. grid%is_mesh) then ! patches are told to those only that share slots with them
          if (.not. matters(grid, mine, block_at_key(heard(i)))) cycle
        end if
        n = n + 1
        ghost_at(:, n) = block_at_key(heard(i))
        border%ghost_rank(n) = r
        call insert_key(border%ghost_of, heard(i), n, value)
      end do
    end do
    ghost_at = ghost_at(:, :n)
    border%ghost_rank = border%ghost_rank(:n)
  end subroutine find_ghosts

  !> Other ranks that own patches whose pads have nodes in the same slots as that of a patch
  subroutine ranks_near_patch(patches, cut, patch, list, n)
    type(patches_t), intent(in) :: patches
    integer(i8), intent(in) :: cut(0:)
    integer, intent(in) :: patch
    integer, intent(out) :: list(:), n
    integer :: k, j, s, r
    n = 0
    do k = patches%near_first(patch), patches%near_first(patch + 1) - 1
      s = patches%near(k) + 1 ! lists count slots from 1
      do j = patches%touch_first(s), patches%touch_first(s + 1) - 1
        r = rank_of_key(cut, block_key([patches%touch(j), 0, 0]))
        if (r == this_rank .or. any(list(:n) == r)) cycle
        n = n + 1
        list(n) = r
      end do
    end do
  end subroutine ranks_near_patch

  !> Other ranks that may have blocks so near to one here that they need nodes which its particles give to
  subroutine ranks_near(grid, cut, at, list, n)
    type(grid_t), intent(in) :: grid
    integer(i8), intent(in) :: cut(0:)
    integer, intent(in) :: at(3)
    integer, intent(out) :: list(:), n
    integer, allocatable :: x(:), y(:), z(:)
    integer :: i, j, k, r, step(3)
    n = 0
    allocate (x(0), y(0), z(0)) ! compilers warn of assignments to what is not allocated
    step = merge(reach, 0, [1, 2, 3] <= grid%dim)
    if (.not. near_images(grid, at)) then
      if (is_mine(cut, block_key(at - step)) .and. is_mine(cut, block_key(at + step))) return ! and all between
    end if
    x = coordinates_near(grid, 1, at(1))
    y = coordinates_near(grid, 2, at(2))
    z = coordinates_near(grid, 3, at(3))
    do k = 1, size(z)
      do j = 1, size(y)
        do i = 1, size(x)
          r = rank_of_key(cut, block_key([x(i), y(j), z(k)]))
          if (r == this_rank .or. any(list(:n) == r)) cycle
          n = n + 1
          list(n) = r
        end do
      end do
    end do
  end subroutine ranks_near

  !> Along one axis: blocks near slots that a block gives to, or near slots that share nodes with those, twice over
  pure function coordinates_near(grid, k, at) result(list)
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: k, at
    integer, allocatable :: list(:)
    integer, allocatable :: slots(:)
    integer :: i, d
    if (k > grid%dim) then
      list = [at]
      return
    end if
    slots = related_along(grid, k, related_along(grid, k, [at - 1, at, at + 1]))
    allocate (list(0))
    do i = 1, size(slots)
      do d = -1, 1
        if (.not. any(list == slots(i) + d)) list = [list, slots(i) + d]
      end do
    end do
  end function coordinates_near

  !> Whether nodes near a block stand for others, or others for them
  pure logical function near_images(grid, at)
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: at(3)
    integer :: k
    near_images = .false.
    if (grid%is_mesh) return
    do k = 1, grid%dim
      if (.not. (grid%periodic(k) .or. grid%mirror_low(k) .or. grid%mirror_high(k))) cycle
      near_images = near_images .or. (at(k) - 1)*grid%edge(k) < 3*grid%edge(k) &
        .or. (at(k) + 2)*grid%edge(k) > grid%cells(k) - 3*grid%edge(k)
    end do
  end function near_images

  !> All positions of a box of blocks
  pure function box_of(low, high) result(list)
    integer, intent(in) :: low(3), high(3)
    integer, allocatable :: list(:, :)
    integer :: x, y, z
    list = reshape([(((x, y, z, x=low(1), high(1)), y=low(2), high(2)), z=low(3), high(3))], [3, product(high - low + 1)])
  end function box_of

  !> Whether a block of another rank gives to nodes that matter here
  logical function matters(grid, mine, at)
    type(grid_t), intent(in) :: grid
    type(hash_table_t), intent(in) :: mine !! keys of the blocks of this rank
    integer, intent(in) :: at(3)
    integer :: x, y, z, step(3)
    matters = near_images(grid, at)
    step = merge(reach, 0, [1, 2, 3] <= grid%dim)
    do z = at(3) - step(3), at(3) + step(3)
      do y = at(2) - step(2), at(2) + step(2)
        do x = at(1) - step(1), at(1) + step(1)
          if (matters) return
          matters = find_key(mine, block_key([x, y, z])) > 0
        end do
      end do
    end do
  end function matters

  !> Further slots: those with images of nodes that are wanted here, though no block of this rank is near
  subroutine add_related(grid, border, block_at, extra)
    type(grid_t), intent(in) :: grid
    type(border_t), intent(in) :: border
    integer, intent(in) :: block_at(:, :)
    integer, allocatable, intent(inout) :: extra(:, :)
    type(hash_table_t) :: seen
    integer(i8), allocatable :: keys(:)
    integer, allocatable :: related(:, :), near(:, :)
    integer :: b, i, n, step(3)
    if (.not. has_images(grid)) return
    step = merge(1, 0, [1, 2, 3] <= grid%dim)
    call clear_table(seen, 64)
    do b = 1, size(extra, 2)
      call note_related(extra(:, b), 0)
    end do
    do b = 1, size(block_at, 2)
      if (near_images(grid, block_at(:, b))) call note_related(block_at(:, b), 1)
    end do
    allocate (keys(seen%n))
    call list_keys(seen, keys)
    related = reshape([(block_at_key(keys(i)), i=1, size(keys))], [3, size(keys)])
    n = 0
    do i = 1, size(keys)
      near = box_of(related(:, i) - step, related(:, i) + step)
      do b = 1, size(near, 2)
        if (find_key(border%ghost_of, block_key(near(:, b))) > 0) exit
      end do
      if (b > size(near, 2)) cycle ! nobody else gives to it
      n = n + 1
      related(:, n) = related(:, i)
    end do
    extra = reshape([extra, related(:, :n)], [3, size(extra, 2) + n])

  contains

    !> Slots that share nodes with those up to `far` blocks from a place
    subroutine note_related(at, far)
      integer, intent(in) :: at(3), far
      integer, allocatable :: x(:), y(:), z(:)
      integer :: i, j, k, value
      allocate (x(0), y(0), z(0)) ! compilers warn of assignments to what is not allocated
      x = related_along(grid, 1, [(at(1) + i, i=-far*step(1), far*step(1))])
      y = related_along(grid, 2, [(at(2) + i, i=-far*step(2), far*step(2))])
      z = related_along(grid, 3, [(at(3) + i, i=-far*step(3), far*step(3))])
      do k = 1, size(z)
        do j = 1, size(y)
          do i = 1, size(x)
            call insert_key(seen, block_key([x(i), y(j), z(k)]), 1, value)
          end do
        end do
      end do
    end subroutine note_related

  end subroutine add_related

  !> A slot is booked by the owner of the first block near it; one that only images give to by that of the first block near those
  subroutine book_slots(grid, table)
    type(grid_t), intent(in) :: grid
    type(block_table_t), intent(inout) :: table
    integer :: s
    do s = 1, table%slots
      table%booked(s) = is_first(table%block_near(:, s))
      if (.not. table%booked(s) .and. all(table%block_near(:, s) == 0)) table%booked(s) = booked_by_image(s)
    end do

  contains

    pure logical function is_first(near)
      integer, intent(in) :: near(:)
      integer :: k
      k = findloc(near > 0, .true., dim=1)
      is_first = .false.
      if (k > 0) is_first = near(k) <= table%blocks
    end function is_first

    logical function booked_by_image(s)
      integer, intent(in) :: s
      integer, allocatable :: related(:, :), order(:)
      integer(i8), allocatable :: keys(:)
      integer :: j, t
      booked_by_image = .false.
      call related_blocks(grid, table%slot_at(:, s), related)
      keys = [(block_key(related(:, j)), j=1, size(related, 2))]
      call sort_order(keys, order)
      do j = 1, size(order)
        t = find_key(table%slot_of, keys(order(j)))
        if (t == 0 .or. t == s) cycle
        if (all(table%block_near(:, t) == 0)) cycle
        if (.not. stands_for(grid, related(:, order(j)), table%slot_at(:, s))) cycle
        booked_by_image = is_first(table%block_near(:, t))
        return
      end do
    end function booked_by_image

  end subroutine book_slots

  !> Whether some node of the slot at `from` stands for one of that at `to`
  pure logical function stands_for(grid, from, to)
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: from(3), to(3)
    integer :: place, node(3), target(3)
    real(wp) :: sign(3)
    stands_for = .false.
    do place = 0, nodes_per_block - 1
      node = from*grid%edge + [modulo(place, grid%edge(1)), modulo(place/grid%edge(1), grid%edge(2)), &
                               place/(grid%edge(1)*grid%edge(2))]
      call canonical_node(grid, node, target, sign)
      if (all(block_of_node(grid, target) == to) .and. any(target /= node)) then
        stands_for = .true.
        return
      end if
    end do
  end function stands_for

end module gimp_ghosts
