!> Which blocks of the grid exist: those that hold particles, and those whose nodes a particle's support can touch.
!>
!> A particle belongs to a block as of the last sort. A slot is a block with nodes: every particle block and its
!> neighbours. Blocks and slots are numbered in the order of their keys, which is also the order of every sum.
module gimp_blocks
  use gimp_kinds, only: i8
  use gimp_grid, only: grid_t, block_key, block_of_node
  use gimp_hash_table, only: hash_table_t, clear_table, insert_key, find_key
  use gimp_sorting, only: sort_order
  implicit none(type, external)
  private
  public :: block_table_t, build_blocks, neighbour, slot_of_node, node_in_block

  !> The active blocks and who neighbours whom
  type :: block_table_t
    integer :: blocks = 0 !! blocks with particles
    integer :: slots = 0 !! blocks with nodes
    integer, allocatable :: block_at(:, :) !! (3, block) position in blocks
    integer, allocatable :: slot_at(:, :) !! (3, slot) position in blocks
    integer(i8), allocatable :: block_code(:) !! (block) key
    integer, allocatable :: slot_near(:, :) !! (27, block) slots around a block, itself at 14
    integer, allocatable :: block_near(:, :) !! (27, slot) blocks around a slot, 0 where there is none
    integer, allocatable :: own_block(:) !! (slot) its particle block or 0
    type(hash_table_t) :: slot_of !! key -> slot
  end type block_table_t

contains

  !> Index 1..27 of the neighbour at an offset of -1, 0, 1 along each axis
  pure integer function neighbour(dx, dy, dz)
    integer, intent(in) :: dx, dy, dz
    neighbour = 14 + dx + 3*dy + 9*dz
  end function neighbour

  !> Build the tables for the blocks at `at`, given in ascending order of their keys and without repeats
  subroutine build_blocks(table, grid, at, extra)
    type(block_table_t), intent(inout) :: table
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: at(:, :) !! (3, block)
    integer, intent(in) :: extra(:, :) !! (3, any) further slots wanted: images of periodic and symmetric sides
    integer, allocatable :: found(:, :), order(:)
    integer(i8), allocatable :: keys(:)
    integer :: reach(3), b, dx, dy, dz, n, s, value

    reach = merge(1, 0, [1, 2, 3] <= grid%dim)
    table%blocks = size(at, 2)
    table%block_at = at
    allocate (found(3, table%blocks*3**grid%dim + size(extra, 2)))
    call clear_table(table%slot_of, 2*table%blocks + 16)
    n = 0
    do b = 1, table%blocks
      do dz = -reach(3), reach(3)
        do dy = -reach(2), reach(2)
          do dx = -reach(1), reach(1)
            call note_slot(at(:, b) + [dx, dy, dz])
          end do
        end do
      end do
    end do
    do b = 1, size(extra, 2)
      call note_slot(extra(:, b))
    end do

    allocate (keys(n))
    do s = 1, n
      keys(s) = block_key(found(:, s))
    end do
    call sort_order(keys, order)
    table%slots = n
    table%slot_at = found(:, order)
    call clear_table(table%slot_of, n)
    do s = 1, n
      call insert_key(table%slot_of, keys(order(s)), s, value)
    end do
    call connect(table, reach)

  contains

    subroutine note_slot(here)
      integer, intent(in) :: here(3)
      call insert_key(table%slot_of, block_key(here), n + 1, value)
      if (value <= n) return
      n = n + 1
      found(:, n) = here
    end subroutine note_slot

  end subroutine build_blocks

  !> Fill the neighbour tables
  subroutine connect(table, reach)
    type(block_table_t), intent(inout) :: table
    integer, intent(in) :: reach(3)
    integer :: b, s, dx, dy, dz
    if (allocated(table%slot_near)) deallocate (table%slot_near, table%block_near, table%own_block, table%block_code)
    allocate (table%slot_near(27, table%blocks), source=0)
    allocate (table%block_near(27, table%slots), source=0)
    allocate (table%own_block(table%slots), source=0)
    allocate (table%block_code(table%blocks))
    do b = 1, table%blocks
      table%block_code(b) = block_key(table%block_at(:, b))
      do dz = -reach(3), reach(3)
        do dy = -reach(2), reach(2)
          do dx = -reach(1), reach(1)
            s = find_key(table%slot_of, block_key(table%block_at(:, b) + [dx, dy, dz]))
            table%slot_near(neighbour(dx, dy, dz), b) = s
            table%block_near(neighbour(-dx, -dy, -dz), s) = b
          end do
        end do
      end do
      table%own_block(table%slot_near(14, b)) = b
    end do
  end subroutine connect

  !> Slot of the block that holds a node, 0 if it is not active
  pure integer function slot_of_node(table, grid, node) result(slot)
    type(block_table_t), intent(in) :: table
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: node(3) !! node coordinates, ghosts negative
    slot = find_key(table%slot_of, block_key(block_of_node(grid, node)))
  end function slot_of_node

  !> Position 1..64 of a node in its block
  pure integer function node_in_block(grid, node) result(place)
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: node(3)
    place = 1 + modulo(node(1), grid%edge(1)) + grid%edge(1)*(modulo(node(2), grid%edge(2)) &
      + grid%edge(2)*modulo(node(3), grid%edge(3)))
  end function node_in_block

end module gimp_blocks
