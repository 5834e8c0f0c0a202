!> Block keys are unique and reversible in order; tables of blocks find every neighbour and every node
program test_blocks
  use gimp_kinds, only: wp, i8
  use gimp_grid, only: grid_t, make_grid, block_edge, block_key, block_of_node, nodes_per_block, longest_axis, has_images
  use gimp_blocks, only: block_table_t, build_blocks, neighbour, slot_of_node, node_in_block
  use gimp_sorting, only: sort_order
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  integer :: dim

  call begin_suite("blocks")
  call test_grid()
  call test_keys()
  do dim = 1, 3
    call test_places(dim)
    call test_tables(dim)
  end do
  call end_suite()

contains

  subroutine test_grid()
    type(grid_t) :: grid
    grid = make_grid(2, [-1.0_wp, 0.0_wp], [1.0_wp, 0.3_wp], 0.1_wp)
    call check_true(all(grid%cells == [20, 3, 1]), "cells of a box whose edges are not exact in binary")
    call check_true(.not. has_images(grid), "a plain box has no images")
    do dim = 1, 3
      call check(product(block_edge(dim)), nodes_per_block, "64 nodes in a block, dimension "//text_of(dim))
    end do
  end subroutine test_grid

  !> Interleaved bits: unique, monotone along each axis, right at the ends of the range; eight children are consecutive
  subroutine test_keys()
    integer(i8) :: key, last
    integer :: i, j, k, wrong
    wrong = 0
    do k = -3, 3
      do j = -3, 3
        last = -1
        do i = -200, 200
          key = block_key([i, j, k])
          if (key <= last) wrong = wrong + 1
          last = key
          if (key /= by_bits([i, j, k])) wrong = wrong + 1
        end do
      end do
    end do
    call check(wrong, 0, "keys interleave the bits of the coordinates and ascend along an axis")
    i = longest_axis/2
    call check_true(block_key([-i, -i, -i]) == 0_i8, "the lowest block has key 0")
    call check_true(block_key([i - 1, i - 1, i - 1]) == shiftl(1_i8, 60) - 1, "the highest fills 60 bits")
    call check_true(block_key([1, 1, 1]) - block_key([0, 0, 0]) == 7, "eight children are consecutive")
  end subroutine test_keys

  pure integer(i8) function by_bits(at) result(key)
    integer, intent(in) :: at(3)
    integer :: bit, k
    key = 0
    do bit = 0, 19
      do k = 1, 3
        if (btest(at(k) + longest_axis/2, bit)) key = ibset(key, 3*bit + k - 1)
      end do
    end do
  end function by_bits

  !> The block of a node and its place there give the node back, also for ghosts
  subroutine test_places(dim)
    integer, intent(in) :: dim
    type(grid_t) :: grid
    integer :: node(3), at(3), place, i, j, k, wrong, reach(3)
    grid = make_grid(dim, [0.0_wp, 0.0_wp, 0.0_wp], [9.0_wp, 9.0_wp, 9.0_wp], 1.0_wp)
    reach = merge(10, 0, [1, 2, 3] <= dim)
    wrong = 0
    do k = -reach(3), reach(3)
      do j = -reach(2), reach(2)
        do i = -reach(1), reach(1)
          at = block_of_node(grid, [i, j, k])
          place = node_in_block(grid, [i, j, k]) - 1
          if (place < 0 .or. place >= nodes_per_block) wrong = wrong + 1
          node = at*grid%edge + [modulo(place, grid%edge(1)), modulo(place/grid%edge(1), grid%edge(2)), &
                                 place/(grid%edge(1)*grid%edge(2))]
          if (any(node /= [i, j, k])) wrong = wrong + 1
        end do
      end do
    end do
    call check(wrong, 0, "block and place give the node back, dimension "//text_of(dim))
  end subroutine test_places

  !> Random blocks, some alone and some side by side: every slot around a block is there once, slots ascend by key, both
  !> neighbour tables are each other's inverse, and what was not asked for does not exist. Then a second, smaller set.
  subroutine test_tables(dim)
    integer, intent(in) :: dim
    type(grid_t) :: grid
    type(block_table_t) :: table
    integer, allocatable :: at(:, :)
    integer :: round, extra(3, 2), nothing(3, 0)
    grid = make_grid(dim, [0.0_wp, 0.0_wp, 0.0_wp], [640.0_wp, 640.0_wp, 640.0_wp], 1.0_wp)
    do round = 1, 3
      call some_blocks(dim, 60/round, round, at)
      if (round == 2) then
        extra = 0
        extra(1, :) = [500, 500] ! named twice, must exist once
        call build_blocks(table, grid, at, extra)
        call check_true(slot_of_node(table, grid, extra(:, 1)*grid%edge) > 0, "slots asked for exist")
        call verify(table, grid, dim, at, 1)
      else
        call build_blocks(table, grid, at, nothing)
        call check(slot_of_node(table, grid, [500, 0, 0]*grid%edge), 0, "a slot of the round before is forgotten")
        call verify(table, grid, dim, at, 0)
      end if
    end do
  end subroutine test_tables

  !> n different blocks in the order of their keys
  subroutine some_blocks(dim, n, round, at)
    integer, intent(in) :: dim, n, round
    integer, allocatable, intent(out) :: at(:, :)
    integer :: found(3, n), k, m, seed, range
    integer, allocatable :: order(:)
    integer(i8) :: keys(n)
    range = merge(200, merge(17, 6, dim == 2), dim == 1)
    seed = 99 + round
    m = 0
    do while (m < n)
      found(:, m + 1) = 0
      do k = 1, dim
        seed = modulo(16807*modulo(seed, 127773) - 2836*(seed/127773), 2147483647)
        found(k, m + 1) = int(range*(seed/2147483647.0_wp)) - 3
      end do
      if (any([(all(found(:, k) == found(:, m + 1)), k=1, m)])) cycle
      m = m + 1
    end do
    do k = 1, n
      keys(k) = block_key(found(:, k))
    end do
    call sort_order(keys, order)
    at = found(:, order)
  end subroutine some_blocks

  subroutine verify(table, grid, dim, at, others)
    type(block_table_t), intent(in) :: table
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: dim, at(:, :), others
    integer :: b, s, n, dx, dy, dz, reach(3), wrong, wanted, here(3), q
    logical :: near
    reach = merge(1, 0, [1, 2, 3] <= dim)
    call check(table%blocks, size(at, 2), "every block is there")
    wrong = 0
    do b = 1, table%blocks
      if (any(table%block_at(:, b) /= at(:, b)) .or. table%block_code(b) /= block_key(at(:, b))) wrong = wrong + 1
      do dz = -1, 1
        do dy = -1, 1
          do dx = -1, 1
            s = table%slot_near(neighbour(dx, dy, dz), b)
            if (any(abs([dx, dy, dz]) > reach)) then
              if (s /= 0) wrong = wrong + 1
              cycle
            end if
            if (s < 1 .or. s > table%slots) then
              wrong = wrong + 1
              cycle
            end if
            if (any(table%slot_at(:, s) /= at(:, b) + [dx, dy, dz])) wrong = wrong + 1
            if (table%block_near(neighbour(-dx, -dy, -dz), s) /= b) wrong = wrong + 1
          end do
        end do
      end do
      if (table%own_block(table%slot_near(14, b)) /= b) wrong = wrong + 1
    end do
    call check(wrong, 0, "slots around every block, dimension "//text_of(dim))
    wrong = 0
    wanted = 0
    do s = 1, table%slots
      here = table%slot_at(:, s)
      if (s > 1) then
        if (block_key(here) <= block_key(table%slot_at(:, s - 1))) wrong = wrong + 1
      end if
      if (slot_of_node(table, grid, here*grid%edge) /= s) wrong = wrong + 1
      if (slot_of_node(table, grid, here*grid%edge + grid%edge - 1) /= s) wrong = wrong + 1
      near = .false.
      n = 0
      do b = 1, table%blocks
        if (any(abs(at(:, b) - here) > reach)) cycle
        near = .true.
        n = n + 1
        q = neighbour(at(1, b) - here(1), at(2, b) - here(2), at(3, b) - here(3))
        if (table%block_near(q, s) /= b) wrong = wrong + 1
      end do
      if (count(table%block_near(:, s) > 0) /= n) wrong = wrong + 1
      if (near) wanted = wanted + 1
    end do
    call check(wrong, 0, "blocks around every slot, dimension "//text_of(dim))
    call check(table%slots, wanted + others, "no slot without reason, dimension "//text_of(dim))
  end subroutine verify

end program test_blocks
