!> Ghosts of periodic and symmetric sides: what they collect goes to the node they stand for, once, with the right signs
program test_images
  use gimp_kinds, only: wp
  use gimp_grid, only: grid_t, make_grid, nodes_per_block, fields_per_node, node_mass, canonical_node
  use gimp_blocks, only: block_table_t, build_blocks, slot_of_node, node_in_block
  use gimp_images, only: image_t, images_wanted, build_images, fold_images, copy_images
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  call begin_suite("images")
  call test_canonical()
  call test_periodic(12)
  call test_periodic(16)
  call test_periodic(3)
  call test_mirror()
  call test_corner()
  call end_suite()

contains

  subroutine test_canonical()
    type(grid_t) :: grid
    integer :: target(3)
    real(wp) :: sign(3)
    grid = make_grid(2, [0.0_wp, 0.0_wp], [13.0_wp, 9.0_wp], 1.0_wp)
    grid%periodic(1) = .true.
    grid%mirror_low(2) = .true.
    grid%mirror_high(2) = .true.
    call canonical_node(grid, [13, 4, 0], target, sign)
    call check_true(all(target == [0, 4, 0]) .and. all(sign == 1.0_wp), "the last node of a periodic axis is the first")
    call canonical_node(grid, [-2, -1, 0], target, sign)
    call check_true(all(target == [11, 1, 0]), "both axes at once")
    call check(sign, [1.0_wp, -1.0_wp, 1.0_wp], 0.0_wp, "only the mirror turns its axis")
    call canonical_node(grid, [5, 11, 0], target, sign)
    call check_true(all(target == [5, 7, 0]) .and. sign(2) == -1.0_wp, "the upper mirror")
    call canonical_node(grid, [5, -12, 0], target, sign)
    call check_true(all(target == [5, 6, 0]) .and. all(sign == 1.0_wp), "a far image is turned by both mirrors")
    call canonical_node(grid, [5, 9, 0], target, sign)
    call check_true(all(target == [5, 9, 0]) .and. sign(2) == 1.0_wp, "a node on a mirror stands for itself")
  end subroutine test_canonical

  !> A periodic line of n cells (2D, so that blocks of 8 nodes do not divide 12 or 3), with blocks on both sides of the seam:
  !> every node in reach of a particle block finds its partner, nothing is lost, and images show what their nodes have
  subroutine test_periodic(n)
    integer, intent(in) :: n
    type(grid_t) :: grid
    type(block_table_t) :: table
    type(image_t), allocatable :: images(:)
    integer, allocatable :: extra(:, :)
    integer :: at(3, 2), k, slot, place, wrong, i
    real(wp), allocatable :: g(:, :, :)
    real(wp) :: total(fields_per_node)
    grid = make_grid(2, [0.0_wp, 0.0_wp], [real(n, wp), 8.0_wp], 1.0_wp)
    grid%periodic(1) = .true.
    at(:, 1) = [-1, 0, 0]
    at(:, 2) = [(n - 1)/8, 0, 0]
    if (at(1, 2) == 0) at(1, 2) = 0
    call images_wanted(grid, at, extra)
    call build_blocks(table, grid, at, extra)
    call build_images(grid, table, images)
    wrong = 0
    do i = -16, n + 15 ! all nodes that some particle of the two blocks could reach
      if (slot_of_node(table, grid, [i, 3, 0]) == 0) cycle
      if (slot_of_node(table, grid, [modulo(i, n), 3, 0]) == 0) wrong = wrong + 1
    end do
    call check(wrong, 0, "every image in reach has its node, n = "//text_of(n))
    allocate (g(fields_per_node, nodes_per_block, table%slots))
    call fill(g)
    total = sum(sum(g, 3), 2)
    call fold_images(images, table%slots, g)
    call check(sum(sum(g, 3), 2), total, 1.0e-12_wp*maxval(abs(total)), "folding keeps all sums, n = "//text_of(n))
    wrong = 0
    do k = 1, size(images)
      if (any(g(:, images(k)%place, images(k)%slot) /= 0.0_wp)) wrong = wrong + 1
    end do
    call check(wrong, 0, "folded images are empty, n = "//text_of(n))
    call copy_images(images, table%slots, g)
    wrong = 0
    do k = 1, size(images)
      if (g(node_mass, images(k)%place, images(k)%slot) /= 0.0_wp) wrong = wrong + 1
    end do
    call check(wrong, 0, "but have no mass, so that no sum over nodes counts them again, n = "//text_of(n))
    wrong = 0
    do i = -16, n + 15
      slot = slot_of_node(table, grid, [i, 3, 0])
      if (slot == 0) cycle
      place = node_in_block(grid, [i, 3, 0])
      if (any(g(:3, place, slot) /= g(:3, node_in_block(grid, [modulo(i, n), 3, 0]), &
                                      slot_of_node(table, grid, [modulo(i, n), 3, 0])))) wrong = wrong + 1
    end do
    call check(wrong, 0, "images show the vectors of their nodes, n = "//text_of(n))
  end subroutine test_periodic

  !> Reproducible numbers without pattern
  subroutine fill(g)
    real(wp), intent(out) :: g(:, :, :)
    integer :: i, j, k
    do k = 1, size(g, 3)
      do j = 1, size(g, 2)
        do i = 1, size(g, 1)
          g(i, j, k) = sin(12.9898_wp*i + 78.233_wp*j + 37.719_wp*k)
        end do
      end do
    end do
  end subroutine fill

  !> One plane of symmetry: normal components change sign, tangential ones and mass do not, on the way there and back
  subroutine test_mirror()
    type(grid_t) :: grid
    type(block_table_t) :: table
    type(image_t), allocatable :: images(:)
    integer, allocatable :: extra(:, :)
    integer :: at(3, 1), ghost(2), node(2)
    real(wp), allocatable :: g(:, :, :)
    real(wp) :: before(8), given(8)
    grid = make_grid(3, [0.0_wp, 0.0_wp, 0.0_wp], [8.0_wp, 8.0_wp, 8.0_wp], 1.0_wp)
    grid%mirror_low(3) = .true.
    at(:, 1) = [0, 0, 0]
    call images_wanted(grid, at, extra)
    call build_blocks(table, grid, at, extra)
    call build_images(grid, table, images)
    allocate (g(fields_per_node, nodes_per_block, table%slots))
    call fill(g)
    ghost = [node_in_block(grid, [1, 2, -3]), slot_of_node(table, grid, [1, 2, -3])]
    node = [node_in_block(grid, [1, 2, 3]), slot_of_node(table, grid, [1, 2, 3])]
    given = g(:, ghost(1), ghost(2))
    before = g(:, node(1), node(2))
    call fold_images(images, table%slots, g)
    call check(g(:, node(1), node(2)), before + given*[1, 1, -1, 1, 1, 1, -1, 1], 1.0e-15_wp, "a mirror turns normal components")
    call copy_images(images, table%slots, g)
    call check(g([1, 2, 3, 5, 6, 7], ghost(1), ghost(2)), g([1, 2, 3, 5, 6, 7], node(1), node(2))*[1, 1, -1, 1, 1, -1], 0.0_wp, &
               "and turns them again on the way back")
  end subroutine test_mirror

  !> Two mirrors meet: an image of both axes gives all it has to the node across the edge
  subroutine test_corner()
    type(grid_t) :: grid
    type(block_table_t) :: table
    type(image_t), allocatable :: images(:)
    integer, allocatable :: extra(:, :)
    integer :: at(3, 1), place, slot
    real(wp), allocatable :: g(:, :, :)
    grid = make_grid(2, [0.0_wp, 0.0_wp], [24.0_wp, 24.0_wp], 1.0_wp)
    grid%mirror_high(1:2) = .true.
    at(:, 1) = [2, 2, 0]
    call images_wanted(grid, at, extra)
    call build_blocks(table, grid, at, extra)
    call build_images(grid, table, images)
    allocate (g(fields_per_node, nodes_per_block, table%slots), source=0.0_wp)
    g(:, node_in_block(grid, [26, 25, 0]), slot_of_node(table, grid, [26, 25, 0])) = 1.0_wp
    call fold_images(images, table%slots, g)
    place = node_in_block(grid, [22, 23, 0])
    slot = slot_of_node(table, grid, [22, 23, 0])
    call check(g(:, place, slot), [-1.0_wp, -1.0_wp, 1.0_wp, 1.0_wp, -1.0_wp, -1.0_wp, 1.0_wp, 1.0_wp], 0.0_wp, &
               "an image beyond two mirrors turns both axes")
    call check(sum(g(node_mass, :, :)), 1.0_wp, 0.0_wp, "and its mass arrives once")
  end subroutine test_corner

end program test_images
