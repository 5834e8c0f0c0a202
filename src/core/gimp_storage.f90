!> Large arrays on a cache line: a vector of 64 bytes must not straddle two lines (`allocate` gives multiples of 16).
module gimp_storage
  use gimp_kinds, only: wp, i8
  use, intrinsic :: iso_c_binding, only: c_ptr, c_size_t, c_intptr_t, c_null_ptr, c_associated
  implicit none(type, external)
  private
  public :: storage_t, reserve_storage, extend_storage, real_bytes

  integer, parameter :: line = 64 !! bytes of a cache line
  integer(i8), parameter :: real_bytes = storage_size(1.0_wp)/8

  !> A block of aligned memory that only grows; its owner points into it with `c_f_pointer`
  type :: storage_t
    type(c_ptr) :: address = c_null_ptr !! on a cache line
    integer(i8) :: bytes = 0
    type(c_ptr), private :: start = c_null_ptr !! of what the system gave
  end type storage_t

  interface
    function c_realloc(start, bytes) bind(c, name="realloc") result(address)
      import :: c_size_t, c_ptr
      implicit none(type, external)
      type(c_ptr), value :: start
      integer(c_size_t), value :: bytes
      type(c_ptr) :: address
    end function c_realloc
    subroutine c_free(address) bind(c, name="free")
      import :: c_ptr
      implicit none(type, external)
      type(c_ptr), value :: address
    end subroutine c_free
    function c_memmove(to, from, bytes) bind(c, name="memmove") result(address)
      import :: c_size_t, c_ptr
      implicit none(type, external)
      type(c_ptr), value :: to, from
      integer(c_size_t), value :: bytes
      type(c_ptr) :: address
    end function c_memmove
  end interface

contains

  !> Make room for at least so many bytes; what was stored is lost when the memory has to move
  subroutine reserve_storage(storage, bytes)
    type(storage_t), intent(inout) :: storage
    integer(i8), intent(in) :: bytes
    if (max(int(line, i8), bytes) <= storage%bytes) return ! nothing, too, lies somewhere: a rank may have no block
    if (c_associated(storage%start)) call c_free(storage%start)
    storage = storage_t()
    call extend_storage(storage, bytes)
  end subroutine reserve_storage

  !> Make room for at least so many bytes and keep what is stored. Large blocks are remapped by the system, not copied, so that
  !> there are never two of them; pages that nobody touched cost no memory.
  subroutine extend_storage(storage, bytes)
    type(storage_t), intent(inout) :: storage
    integer(i8), intent(in) :: bytes
    type(c_ptr) :: start, ignored
    integer(i8) :: wanted, off, old_off
    wanted = max(int(line, i8), bytes)
    if (wanted <= storage%bytes) return
    wanted = wanted + wanted/8 ! room to grow: the number of chunks changes a little with every sort
    old_off = 0
    if (c_associated(storage%start)) old_off = address_of(storage%address) - address_of(storage%start)
    start = c_realloc(storage%start, int(wanted + line, c_size_t))
    if (.not. c_associated(start)) error stop "gimp.x: out of memory"
    off = modulo(-address_of(start), int(line, i8))
    if (off /= old_off .and. storage%bytes > 0) &
      ignored = c_memmove(pointer_to(address_of(start) + off), pointer_to(address_of(start) + old_off), &
                          int(storage%bytes, c_size_t))
    storage%start = start
    storage%address = pointer_to(address_of(start) + off)
    storage%bytes = wanted
  end subroutine extend_storage

  pure integer(i8) function address_of(pointer)
    type(c_ptr), intent(in) :: pointer
    address_of = int(transfer(pointer, 0_c_intptr_t), i8)
  end function address_of

  pure type(c_ptr) function pointer_to(address)
    integer(i8), intent(in) :: address
    pointer_to = transfer(int(address, c_intptr_t), c_null_ptr)
  end function pointer_to

end module gimp_storage
