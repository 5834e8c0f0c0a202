!> Nodes that stand for others: ghosts of periodic sides and of planes of symmetry.
!>
!> Contributions to an image are added to the node it stands for, in the order of the list, before nodes are updated;
!> afterwards the image takes that node's values. Any number of cells is allowed on a periodic axis.
module gimp_images
  use gimp_kinds, only: wp, i8
  use gimp_sorting, only: sort_order
  use gimp_grid, only: grid_t, nodes_per_block, fields_per_node, node_mass, has_images, canonical_node, block_of_node
  use gimp_blocks, only: block_table_t, slot_of_node, node_in_block
  use omp_lib, only: omp_get_max_threads
  implicit none(type, external)
  private
  public :: image_t, related_blocks, related_along, images_wanted, build_images, note_images, fold_images, copy_images

  integer, parameter :: few_images = 500 !! not worth waking other threads for

  !> One image and the node it stands for
  type :: image_t
    integer :: slot = 0, place = 0 !! of the image
    integer :: target_slot = 0, target_place = 0 !! of the node it stands for
    real(wp) :: sign(fields_per_node) = 1.0_wp
  end type image_t

contains

  !> Blocks that hold the targets of images near the particle blocks at `at` (with repeats)
  subroutine images_wanted(grid, at, extra)
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: at(:, :) !! (3, block)
    integer, allocatable, intent(out) :: extra(:, :) !! (3, any)
    integer, allocatable :: wider(:, :)
    integer :: b, i, j, k, n, count(3), axis(32, 3), reach(3)
    allocate (extra(3, 0))
    if (.not. has_images(grid)) return
    allocate (wider(3, 64))
    n = 0
    reach = merge(1, 0, [1, 2, 3] <= grid%dim)
    do b = 1, size(at, 2)
      if (all(at(:, b)*grid%edge >= grid%edge .and. (at(:, b) + 2)*grid%edge <= grid%cells .or. reach == 0)) cycle
      do k = 1, 3
        call targets_on_axis(k, (at(k, b) - reach(k))*grid%edge(k), (at(k, b) + reach(k) + 1)*grid%edge(k) - 1)
      end do
      do k = 1, count(3)
        do j = 1, count(2)
          do i = 1, count(1)
            if (n == size(wider, 2)) wider = reshape(wider, [3, 2*n], pad=[0])
            n = n + 1
            wider(:, n) = [axis(i, 1), axis(j, 2), axis(k, 3)]
          end do
        end do
      end do
    end do
    extra = wider(:, :n)

  contains

    !> Blocks that hold the targets of nodes first to last of an axis; an axis does not ask the others
    subroutine targets_on_axis(k, first, last)
      integer, intent(in) :: k, first, last
      integer :: i, node(3), target(3), at(3)
      real(wp) :: sign(3)
      count(k) = 0
      node = 0
      do i = first, last
        node(k) = i
        call canonical_node(grid, node, target, sign)
        at = block_of_node(grid, target)
        if (any(axis(:count(k), k) == at(k)) .or. count(k) == size(axis, 1)) cycle
        count(k) = count(k) + 1
        axis(count(k), k) = at(k)
      end do
    end subroutine targets_on_axis

  end subroutine images_wanted

  !> Blocks that share a node with a block, itself included: some of their nodes stand for each other
  pure subroutine related_blocks(grid, at, list)
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: at(3)
    integer, allocatable, intent(out) :: list(:, :) !! (3, any)
    integer, allocatable :: along(:, :)
    integer :: n(3), k, i, j, l
    allocate (along(64, 3))
    do k = 1, 3
      call related_on_axis(grid, k, at(k), along(:, k), n(k))
    end do
    list = reshape([(((along(i, 1), along(j, 2), along(l, 3), i=1, n(1)), j=1, n(2)), l=1, n(3))], [3, product(n)])
  end subroutine related_blocks

  !> All coordinates along an axis of blocks that share a node with one of a list; axes do not ask each other
  pure function related_along(grid, k, list) result(all)
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: k, list(:)
    integer, allocatable :: all(:)
    integer :: one(64), i, j, n
    allocate (all(0))
    do i = 1, size(list)
      call related_on_axis(grid, k, list(i), one, n)
      do j = 1, n
        if (.not. any(all == one(j))) all = [all, one(j)]
      end do
    end do
  end function related_along

  !> Coordinates along one axis of blocks that share a node with a block
  pure subroutine related_on_axis(grid, k, at, list, n)
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: k, at
    integer, intent(inout) :: list(:)
    integer, intent(out) :: n
    integer :: low, high, i, home
    list(1) = at
    n = 1
    if (k > grid%dim) return
    if (.not. (grid%periodic(k) .or. grid%mirror_low(k) .or. grid%mirror_high(k))) return
    low = 3*grid%edge(k) ! beyond it no image within reach of a particle has its target
    high = grid%cells(k) - 3*grid%edge(k)
    if (at*grid%edge(k) >= low .and. (at + 1)*grid%edge(k) <= high) return
    do i = -low, grid%cells(k) + low
      if (i > low .and. i < high) cycle
      home = (i - modulo(i, grid%edge(k)))/grid%edge(k)
      if (any(list(:n) == home) .or. n == size(list)) cycle
      if (shares_node(i)) then
        n = n + 1
        list(n) = home
      end if
    end do

  contains

    !> Whether a node of the block stands for the same node as node i
    pure logical function shares_node(i)
      integer, intent(in) :: i
      integer :: node(3), target(3), other(3), j
      real(wp) :: sign(3)
      node = 0
      node(k) = i
      call canonical_node(grid, node, target, sign)
      do j = at*grid%edge(k), (at + 1)*grid%edge(k) - 1
        node(k) = j
        call canonical_node(grid, node, other, sign)
        shares_node = other(k) == target(k)
        if (shares_node) return
      end do
    end function shares_node

  end subroutine related_on_axis

  !> List every active node that stands for another, in the order of the slots of the nodes they stand for, then of their own
  subroutine build_images(grid, table, images)
    type(grid_t), intent(in) :: grid
    type(block_table_t), intent(in) :: table
    type(image_t), allocatable, intent(out) :: images(:)
    type(image_t), allocatable :: wider(:)
    integer, allocatable :: order(:)
    integer :: s, place, node(3), target(3), n, slot
    real(wp) :: sign(3)
    allocate (images(0))
    if (.not. has_images(grid)) return
    allocate (wider(64))
    n = 0
    do s = 1, table%slots
      if (all(table%slot_at(:, s) >= 0 .and. (table%slot_at(:, s) + 1)*grid%edge <= grid%cells)) cycle ! inside: no images
      do place = 0, nodes_per_block - 1
        node(1) = modulo(place, grid%edge(1))
        node(2) = modulo(place/grid%edge(1), grid%edge(2))
        node(3) = place/(grid%edge(1)*grid%edge(2))
        node = node + table%slot_at(:, s)*grid%edge
        call canonical_node(grid, node, target, sign)
        if (all(target == node)) cycle
        slot = slot_of_node(table, grid, target)
        if (slot == 0) cycle ! so far from any particle that nothing reaches it
        if (n == size(wider)) wider = [wider, wider]
        n = n + 1
        wider(n) = image_t(s, place + 1, slot, node_in_block(grid, target), [sign, 1.0_wp, sign, 1.0_wp])
      end do
    end do
    call sort_order(int(wider(:n)%target_slot, i8), order)
    images = wider(order)
  end subroutine build_images

  !> What the images hold now, for the books: a mirror turns the normal part of it around
  subroutine note_images(images, slots, g, held)
    type(image_t), intent(in) :: images(:)
    integer, intent(in) :: slots
    real(wp), intent(in) :: g(fields_per_node, nodes_per_block, slots)
    real(wp), intent(out) :: held(fields_per_node, size(images))
    integer :: k
    !$omp parallel do schedule(static) if(size(images) > few_images)
    do k = 1, size(images)
      held(:, k) = g(:, images(k)%place, images(k)%slot)
    end do
    !$omp end parallel do
  end subroutine note_images

  !> Add what images collected to the nodes they stand for, and empty the images
  subroutine fold_images(images, slots, g)
    type(image_t), intent(in) :: images(:)
    integer, intent(in) :: slots
    real(wp), intent(inout) :: g(fields_per_node, nodes_per_block, slots)
    integer :: k, part, parts
    parts = min(size(images)/few_images + 1, omp_get_max_threads())
    !$omp parallel do schedule(static) private(k) if(parts > 1)
    do part = 1, parts
      do k = cut(part - 1), cut(part) - 1
        associate (i => images(k))
          g(:, i%target_place, i%target_slot) = g(:, i%target_place, i%target_slot) + i%sign*g(:, i%place, i%slot)
          g(:, i%place, i%slot) = 0.0_wp
        end associate
      end do
    end do
    !$omp end parallel do

  contains

    !> First image of a part: parts are equal but for images of nodes of one slot, which stay together
    pure integer function cut(part)
      integer, intent(in) :: part
      cut = 1 + int(int(size(images), i8)*part/parts)
      do while (cut > 1 .and. cut <= size(images))
        if (images(cut)%target_slot /= images(cut - 1)%target_slot) exit
        cut = cut + 1
      end do
    end function cut

  end subroutine fold_images

  !> Give images the values of the nodes they stand for, but no mass: no sum over nodes may count them again
  subroutine copy_images(images, slots, g)
    type(image_t), intent(in) :: images(:)
    integer, intent(in) :: slots
    real(wp), intent(inout) :: g(fields_per_node, nodes_per_block, slots)
    integer :: k
    !$omp parallel do schedule(static) if(size(images) > few_images)
    do k = 1, size(images)
      associate (i => images(k))
        g(:, i%place, i%slot) = i%sign*g(:, i%target_place, i%target_slot)
        g(node_mass, i%place, i%slot) = 0.0_wp
      end associate
    end do
    !$omp end parallel do
  end subroutine copy_images

end module gimp_images
