!> Blocks that share nodes by periodic and symmetric sides, against a search over all pairs of nodes
program test_related
  use gimp_kinds, only: wp, dp
  use gimp_grid, only: grid_t, make_grid, canonical_node
  use gimp_images, only: related_blocks, related_along
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check_true
  implicit none(type, external)

  character(len=*), parameter :: names(0:4) = [character(len=8) :: "open", "periodic", "low", "high", "both"]
  integer :: dim, kind, n
  integer, parameter :: axis_cells(12) = [3, 4, 5, 7, 8, 9, 13, 21, 40, 64, 100, 130]

  call begin_suite("related blocks")
  do dim = 1, 3
    do kind = 0, 4
      do n = 1, size(axis_cells)
        call test_axis(dim, kind, axis_cells(n))
      end do
    end do
  end do
  call test_corner()
  call test_list()
  call end_suite()

contains

  !> A grid with sides of one kind on its first axis
  function grid_of(dim, kind, cells) result(grid)
    integer, intent(in) :: dim, kind, cells
    type(grid_t) :: grid
    real(dp) :: low(3), high(3)
    low = 0.0_dp
    high = cells
    grid = make_grid(dim, low, high, 1.0_dp)
    grid%periodic(1) = kind == 1
    grid%mirror_low(1) = kind == 2 .or. kind == 4
    grid%mirror_high(1) = kind == 3 .or. kind == 4
  end function grid_of

  !> Of all blocks that particles in the box can give to: relation along the first axis
  subroutine test_axis(dim, kind, cells)
    integer, intent(in) :: dim, kind, cells
    type(grid_t) :: grid
    integer, allocatable :: list(:, :)
    integer :: at, other, last
    logical :: found, expected
    grid = grid_of(dim, kind, cells)
    last = cells/grid%edge(1) + 1
    do at = -2, last
      call related_blocks(grid, [at, 1, 0], list)
      call check_true(all(list(2, :) == 1) .and. all(list(3, :) == 0), "other axes are left alone")
      call check_true(count(list(1, :) == at) == 1, "a block is related to itself, once")
      do other = -2, last
        found = any(list(1, :) == other)
        expected = share_nodes(grid, at, other)
        call check_true(found .eqv. expected, trim(names(kind))//", "//text_of(cells)//" cells, "//text_of(dim)//"D: blocks " &
                        //text_of(at)//" and "//text_of(other))
      end do
    end do
  end subroutine test_axis

  !> Whether some node of one block stands for a node of another, or for the same third one
  logical function share_nodes(grid, one, other)
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: one, other
    integer :: i, j, node(3), first(3), second(3)
    real(wp) :: sign(3)
    share_nodes = .true.
    if (one == other) return
    node = 0
    do i = one*grid%edge(1), (one + 1)*grid%edge(1) - 1
      node(1) = i
      call canonical_node(grid, node, first, sign)
      do j = other*grid%edge(1), (other + 1)*grid%edge(1) - 1
        node(1) = j
        call canonical_node(grid, node, second, sign)
        if (all(first == second)) return
      end do
    end do
    share_nodes = .false.
  end function share_nodes

  !> At a corner of several axes: every pair of what is related along each
  subroutine test_corner()
    type(grid_t) :: grid
    integer, allocatable :: list(:, :)
    integer :: k, n(3)
    grid = grid_of(3, 1, 13)
    grid%mirror_low(2) = .true.
    grid%periodic(3) = .true.
    call related_blocks(grid, [0, 0, 3], list)
    do k = 1, 3
      n(k) = size(related_along(grid, k, [merge(3, 0, k == 3)]))
      call check_true(n(k) > 1, "more than one along each axis")
    end do
    call check_true(size(list, 2) == product(n), "a corner: as many as there are combinations")
  end subroutine test_corner

  !> Of a list: what is related to any of it, each once
  subroutine test_list()
    type(grid_t) :: grid
    integer, allocatable :: all_of_them(:), list(:, :)
    integer :: k, i
    grid = grid_of(2, 1, 21)
    all_of_them = related_along(grid, 1, [-1, 0, 1])
    do k = -1, 1
      call related_blocks(grid, [k, 5, 0], list)
      do i = 1, size(list, 2)
        call check_true(count(all_of_them == list(1, i)) == 1, "each once")
      end do
    end do
  end subroutine test_list

end program test_related
