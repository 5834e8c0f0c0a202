!> Which patches and slots of a mesh exist: patches that hold particles, and slots that their pads have nodes in (see gimp_blocks)
module gimp_mesh_blocks
  use gimp_kinds, only: i8
  use gimp_grid, only: block_key
  use gimp_hash_table, only: clear_table, insert_key
  use gimp_blocks, only: block_table_t, clear_neighbours
  use gimp_patches, only: patches_t
  implicit none(type, external)
  private
  public :: build_mesh_blocks

contains

  !> Build the tables for the patches at `at`, in ascending order and without repeats
  subroutine build_mesh_blocks(table, patches, at, ghost_at)
    type(block_table_t), intent(inout) :: table
    type(patches_t), intent(in) :: patches
    integer, intent(in) :: at(:, :) !! (3, block) number of the patch, 0, 0
    integer, intent(in), optional :: ghost_at(:, :) !! (3, ghost) patches of other ranks
    integer :: block_of(patches%n), slot_number(0:patches%slots - 1), b, k, s, p, value
    table%blocks = size(at, 2)
    table%ghosts = 0
    table%block_at = at
    if (present(ghost_at)) then
      table%ghosts = size(ghost_at, 2)
      table%block_at = reshape([at, ghost_at], [3, table%blocks + table%ghosts])
    end if
    call number_slots(table, patches, slot_number)
    call clear_neighbours(table, patches%most_near, patches%most_touch)
    block_of = 0
    do b = 1, table%blocks + table%ghosts
      block_of(table%block_at(1, b)) = b
      table%block_code(b) = block_key(table%block_at(:, b))
    end do
    do b = 1, table%blocks
      p = table%block_at(1, b)
      do k = patches%near_first(p), patches%near_first(p + 1) - 1
        table%slot_near(k + 1 - patches%near_first(p), b) = slot_number(patches%near(k))
      end do
    end do
    call clear_table(table%slot_of, table%slots)
    do s = 1, table%slots
      call insert_key(table%slot_of, block_key(table%slot_at(:, s)), s, value)
      p = table%slot_at(1, s) + 1 ! lists count slots from 1
      do k = patches%touch_first(p), patches%touch_first(p + 1) - 1
        table%block_near(k + 1 - patches%touch_first(p), s) = block_of(patches%touch(k))
      end do
    end do
  end subroutine build_mesh_blocks

  !> Number the slots that pads of patches of this rank have nodes in
  subroutine number_slots(table, patches, slot_number)
    type(block_table_t), intent(inout) :: table
    type(patches_t), intent(in) :: patches
    integer, intent(out) :: slot_number(0:) !! 0: not wanted
    integer :: b, s, p
    slot_number = 0
    do b = 1, table%blocks
      p = table%block_at(1, b)
      slot_number(patches%near(patches%near_first(p):patches%near_first(p + 1) - 1)) = 1
    end do
    table%slots = sum(slot_number)
    if (allocated(table%slot_at)) deallocate (table%slot_at)
    allocate (table%slot_at(3, table%slots), source=0)
    table%slots = 0
    do s = 0, patches%slots - 1
      if (slot_number(s) == 0) cycle
      table%slots = table%slots + 1
      slot_number(s) = table%slots
      table%slot_at(1, table%slots) = s
    end do
  end subroutine number_slots

end module gimp_mesh_blocks
