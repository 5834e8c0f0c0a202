!> A table from 64-bit keys to small integers: open addressing with linear probing, grows by itself
module gimp_hash_table
  use gimp_common_kinds, only: i8
  implicit none(type, external)
  private
  public :: hash_table_t, clear_table, insert_key, find_key, list_keys, mix_bits

  integer(i8), parameter :: empty = -huge(0_i8) - 1_i8 !! no key has this value

  !> Keys and the integers that belong to them
  type :: hash_table_t
    integer :: n = 0 !! keys stored
    integer(i8) :: mask = -1 !! slots - 1; slots are a power of two
    integer(i8), allocatable :: key(:)
    integer, allocatable :: value(:)
  end type hash_table_t

contains

  !> Spread the bits of a key (the finaliser of splitmix64: Steele, Lea & Flood 2014)
  pure elemental integer(i8) function mix_bits(key) result(h)
    integer(i8), intent(in) :: key
    integer(i8), parameter :: c1 = int(z"BF58476D1CE4E5B9", i8), c2 = int(z"94D049BB133111EB", i8)
    h = key
    h = ieor(h, shiftr(h, 30))*c1
    h = ieor(h, shiftr(h, 27))*c2
    h = ieor(h, shiftr(h, 31))
  end function mix_bits

  !> Forget all keys and make room for about `expected` of them
  subroutine clear_table(table, expected)
    type(hash_table_t), intent(inout) :: table
    integer, intent(in) :: expected
    integer(i8) :: slots
    slots = 16
    do while (slots < 2_i8*expected)
      slots = 2*slots
    end do
    if (table%mask + 1 < slots) then
      if (allocated(table%key)) deallocate (table%key, table%value)
      allocate (table%key(0:slots - 1), table%value(0:slots - 1))
      table%mask = slots - 1
    end if
    table%key = empty
    table%n = 0
  end subroutine clear_table

  !> The value of a key; a new key gets `fresh`, which is then the result
  subroutine insert_key(table, key, fresh, value)
    type(hash_table_t), intent(inout) :: table
    integer(i8), intent(in) :: key
    integer, intent(in) :: fresh
    integer, intent(out) :: value
    if (2_i8*(table%n + 1) > table%mask + 1) call grow(table)
    call place_key(table, key, fresh, value)
  end subroutine insert_key

  !> Insert where there is room
  pure subroutine place_key(table, key, fresh, value)
    type(hash_table_t), intent(inout) :: table
    integer(i8), intent(in) :: key
    integer, intent(in) :: fresh
    integer, intent(out) :: value
    integer(i8) :: slot
    slot = iand(mix_bits(key), table%mask)
    do
      if (table%key(slot) == key) then
        value = table%value(slot)
        return
      end if
      if (table%key(slot) == empty) exit
      slot = iand(slot + 1, table%mask)
    end do
    table%key(slot) = key
    table%value(slot) = fresh
    table%n = table%n + 1
    value = fresh
  end subroutine place_key

  !> The value of a key, 0 when the table does not have it
  pure integer function find_key(table, key) result(value)
    type(hash_table_t), intent(in) :: table
    integer(i8), intent(in) :: key
    integer(i8) :: slot
    value = 0
    if (table%n == 0) return
    slot = iand(mix_bits(key), table%mask)
    do
      if (table%key(slot) == key) then
        value = table%value(slot)
        return
      end if
      if (table%key(slot) == empty) return
      slot = iand(slot + 1, table%mask)
    end do
  end function find_key

  !> All keys of a table, in any order
  pure subroutine list_keys(table, keys)
    type(hash_table_t), intent(in) :: table
    integer(i8), intent(out) :: keys(table%n)
    integer(i8) :: k
    integer :: n
    n = 0
    do k = 0, table%mask
      if (table%key(k) == empty) cycle
      n = n + 1
      keys(n) = table%key(k)
    end do
  end subroutine list_keys

  !> Twice the slots
  subroutine grow(table)
    type(hash_table_t), intent(inout) :: table
    integer(i8), allocatable :: keys(:)
    integer, allocatable :: values(:)
    integer(i8) :: k
    integer :: ignored
    call move_alloc(table%key, keys)
    call move_alloc(table%value, values)
    table%mask = 2*(table%mask + 1) - 1
    allocate (table%key(0:table%mask), table%value(0:table%mask))
    table%key = empty
    table%n = 0
    do k = lbound(keys, 1, i8), ubound(keys, 1, i8)
      if (keys(k) /= empty) call place_key(table, keys(k), values(k), ignored)
    end do
  end subroutine grow

end module gimp_hash_table
