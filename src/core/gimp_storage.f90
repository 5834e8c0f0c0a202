!> Large arrays on a cache line: a vector of 64 bytes must not straddle two lines (`allocate` gives multiples of 16).
module gimp_storage
  use gimp_kinds, only: wp, i8
  use, intrinsic :: iso_c_binding, only: c_ptr, c_size_t, c_loc, c_f_pointer, c_null_ptr, c_associated
  implicit none(type, external)
  private
  public :: storage_t, reserve_storage

  !> A block of aligned memory that only grows; its owner points into it with `c_f_pointer`
  type :: storage_t
    type(c_ptr) :: address = c_null_ptr
    integer(i8) :: bytes = 0
  end type storage_t

  interface
    function aligned_alloc(alignment, bytes) bind(c) result(address)
      import :: c_size_t, c_ptr
      implicit none(type, external)
      integer(c_size_t), value :: alignment, bytes
      type(c_ptr) :: address
    end function aligned_alloc
    subroutine c_free(address) bind(c, name="free")
      import :: c_ptr
      implicit none(type, external)
      type(c_ptr), value :: address
    end subroutine c_free
  end interface

contains

  !> Make room for at least `reals` working-precision numbers; what was stored is lost when the memory has to move
  subroutine reserve_storage(storage, reals, moved)
    type(storage_t), intent(inout) :: storage
    integer(i8), intent(in) :: reals
    logical, intent(out) :: moved !! new memory, contents undefined
    integer(i8) :: bytes
    bytes = max(64_i8, reals*(storage_size(1.0_wp)/8))
    moved = bytes > storage%bytes
    if (.not. moved) return
    if (c_associated(storage%address)) call c_free(storage%address)
    bytes = bytes + bytes/8 ! room to grow: the number of chunks changes a little with every sort
    bytes = (bytes + 63)/64*64
    storage%address = aligned_alloc(64_c_size_t, int(bytes, c_size_t))
    storage%bytes = bytes
    if (.not. c_associated(storage%address)) error stop "gimp.x: out of memory"
  end subroutine reserve_storage

end module gimp_storage
