!> Which blocks of the grid exist: those that hold particles, and those whose nodes a particle's support can touch.
!>
!> A particle belongs to a block as of the last sort. A slot is a block with nodes: every particle block and its
!> neighbours. Blocks and slots are numbered in the order of their keys, which is also the order of every sum.
module gimp_blocks
  use gimp_kinds, only: i8
  use gimp_grid, only: grid_t, block_key, keys_around, block_at_key, block_of_node
  use gimp_hash_table, only: hash_table_t, clear_table, insert_key, find_key, list_keys
  use gimp_sorting, only: rank_keys
  use omp_lib, only: omp_get_max_threads
  implicit none(type, external)
  private
  public :: few_blocks, block_table_t, build_blocks, block_with_key, clear_neighbours, neighbour, slot_of_node, node_in_block

  integer, parameter :: few_blocks = 32 !! up to so many blocks or slots are not worth waking other threads for

  !> The active blocks and who neighbours whom
  type :: block_table_t
    integer :: blocks = 0 !! blocks with particles of this rank
    integer :: ghosts = 0 !! blocks of other ranks whose particles reach nodes here; numbered after those of this rank
    integer :: slots = 0 !! blocks with nodes
    integer, allocatable :: block_at(:, :) !! (3, block) position in blocks, ghosts included
    integer, allocatable :: slot_at(:, :) !! (3, slot) position in blocks
    integer(i8), allocatable :: block_code(:) !! (block) key, ghosts included
    integer, allocatable :: slot_near(:, :) !! (27, block) slots around a block, itself at 14; of a mesh: (most slots of a pad, block), those of its pad
    integer, allocatable :: block_near(:, :) !! (27, slot) blocks around a slot, 0 where there is none; of a mesh: (most pads of a slot, slot)
    integer, allocatable :: own_block(:) !! (slot) its particle block or 0; of a mesh: 0
    logical, allocatable :: booked(:) !! (slot) this rank counts it in sums: every slot is counted by one rank
    type(hash_table_t) :: slot_of !! key -> slot
  end type block_table_t

contains

  !> Index 1..27 of the neighbour at an offset of -1, 0, 1 along each axis
  pure integer function neighbour(dx, dy, dz)
    integer, intent(in) :: dx, dy, dz
    neighbour = 14 + dx + 3*dy + 9*dz
  end function neighbour

  !> Build the tables for the blocks at `at`, given in ascending order of their keys and without repeats
  subroutine build_blocks(table, grid, at, extra, ghost_at)
    type(block_table_t), intent(inout) :: table
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: at(:, :) !! (3, block)
    integer, intent(in) :: extra(:, :) !! (3, any) further slots wanted: images of periodic and symmetric sides
    integer, intent(in), optional :: ghost_at(:, :) !! (3, ghost) blocks of other ranks
    integer(i8), allocatable :: keys(:), distinct(:)
    integer, allocatable :: ignored(:)
    integer :: s, value

    table%blocks = size(at, 2)
    table%ghosts = 0
    table%block_at = at
    if (present(ghost_at)) then
      table%ghosts = size(ghost_at, 2)
      table%block_at = reshape([at, ghost_at], [3, table%blocks + table%ghosts])
    end if
    call wanted_keys(grid, at, extra, keys)
    call rank_keys(keys, distinct, ignored)
    table%slots = size(distinct)
    if (allocated(table%slot_at)) deallocate (table%slot_at)
    allocate (table%slot_at(3, table%slots))
    call clear_table(table%slot_of, table%slots)
    do s = 1, table%slots
      table%slot_at(:, s) = block_at_key(distinct(s))
      call insert_key(table%slot_of, distinct(s), s, value)
    end do
    call connect(table, grid%dim)
  end subroutine build_blocks

  !> Keys of all slots, some more than once: each thread lists those around its part of the blocks
  subroutine wanted_keys(grid, at, extra, keys)
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: at(:, :), extra(:, :)
    integer(i8), allocatable, intent(out) :: keys(:)
    type(hash_table_t), allocatable :: found(:)
    integer(i8) :: around(27)
    integer :: parts, part, b, k, n, value
    parts = max(1, min(size(at, 2)/64, 2*omp_get_max_threads()))
    allocate (found(parts))
    !$omp parallel do schedule(dynamic, 1) private(b, k, around, value) if(parts > 1)
    do part = 1, parts
      call clear_table(found(part), 2*(size(at, 2)/parts) + 16)
      do b = 1 + int(int(size(at, 2), i8)*(part - 1)/parts), int(int(size(at, 2), i8)*part/parts)
        around = keys_around(at(:, b))
        do k = 1, 27
          if (is_near(grid%dim, k)) call insert_key(found(part), around(k), 1, value)
        end do
      end do
    end do
    !$omp end parallel do
    allocate (keys(sum(found%n) + size(extra, 2)))
    n = 0
    do part = 1, parts
      call list_keys(found(part), keys(n + 1:n + found(part)%n))
      n = n + found(part)%n
    end do
    do b = 1, size(extra, 2)
      keys(n + b) = block_key(extra(:, b))
    end do
  end subroutine wanted_keys

  !> Whether neighbour k exists in so many dimensions
  pure logical function is_near(dim, k)
    integer, intent(in) :: dim, k
    is_near = (dim > 2 .or. (k > 9 .and. k < 19)) .and. (dim > 1 .or. modulo((k - 1)/3, 3) == 1)
  end function is_near

  !> Fill the neighbour tables; no two blocks write the same entry
  subroutine connect(table, dim)
    type(block_table_t), intent(inout) :: table
    integer, intent(in) :: dim
    integer(i8) :: around(27)
    integer :: b, s, k
    call clear_neighbours(table, 27, 27)
    !$omp parallel do schedule(static) private(around, k, s) if(table%blocks > few_blocks)
    do b = 1, table%blocks
      around = keys_around(table%block_at(:, b))
      table%block_code(b) = around(14)
      do k = 1, 27
        if (.not. is_near(dim, k)) cycle
        s = find_key(table%slot_of, around(k))
        table%slot_near(k, b) = s
        table%block_near(28 - k, s) = b
      end do
      table%own_block(table%slot_near(14, b)) = b
    end do
    !$omp end parallel do
    do b = table%blocks + 1, table%blocks + table%ghosts ! their slots are here only as far as they matter here
      around = keys_around(table%block_at(:, b))
      table%block_code(b) = around(14)
      do k = 1, 27
        if (.not. is_near(dim, k)) cycle
        s = find_key(table%slot_of, around(k))
        if (s > 0) table%block_near(28 - k, s) = b
      end do
    end do
  end subroutine connect

  !> Room for the neighbours of all blocks and slots, none yet
  subroutine clear_neighbours(table, most_slots, most_blocks)
    type(block_table_t), intent(inout) :: table
    integer, intent(in) :: most_slots, most_blocks !! near a block, near a slot
    if (allocated(table%slot_near)) deallocate (table%slot_near, table%block_near, table%own_block, table%block_code, table%booked)
    allocate (table%slot_near(most_slots, table%blocks), source=0)
    allocate (table%block_near(most_blocks, table%slots), source=0)
    allocate (table%own_block(table%slots), source=0)
    allocate (table%booked(table%slots), source=.true.)
    allocate (table%block_code(table%blocks + table%ghosts))
  end subroutine clear_neighbours

  !> The block of this rank with a key, 0 if there is none; keys are in ascending order
  pure integer function block_with_key(table, key) result(block)
    type(block_table_t), intent(in) :: table
    integer(i8), intent(in) :: key
    integer :: low, high
    low = 1
    high = table%blocks
    do while (low < high)
      block = (low + high)/2
      if (table%block_code(block) < key) then
        low = block + 1
      else
        high = block
      end if
    end do
    block = 0
    if (low > high) return
    if (table%block_code(low) == key) block = low
  end function block_with_key

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
