!> The state of an append-only file, the same on all ranks, and what all of `gimp_append_file` needs of it: names, room, bytes.
!>
!> All ranks make the same calls, so that all know where everything goes without a message; only rank 0 writes what all know.
!> A write that fails is kept in `trouble` and nothing more is written; the next commit tells it to all ranks.
module gimp_append_state
  use, intrinsic :: iso_c_binding, only: c_ptr, c_loc
  use gimp_common_kinds, only: i8
  use gimp_error, only: error_t, raise
  use gimp_ranks, only: this_rank
  use gimp_file_system, only: raw_file_t, write_at
  use gimp_hdf5_format, only: superblock_bytes
  use gimp_append_index, only: object_t, a_group
  implicit none(type, external)
  private
  public :: append_file_t, find_object, new_object, check_usable, take_room, put_on_disk, put_bytes, push

  !> An open file; the objects in it are known by number, 1 is the root group
  type :: append_file_t
    character(len=:), allocatable :: path
    logical :: is_open = .false.
    logical :: durable = .false. !! wait for the device at commits
    type(raw_file_t) :: raw !! the descriptor of this rank
    character(len=:), allocatable :: first_name !! until the first commit
    character(len=:), allocatable :: failure !! why the file takes no more; the same on all ranks
    type(error_t), allocatable :: trouble !! of this rank since the last commit
    type(object_t), allocatable :: object(:)
    integer :: objects = 0
    integer(i8) :: used = superblock_bytes !! bytes given away
    integer(i8) :: reserved = 0 !! present length of the file
    integer(i8) :: area(2) = 0, room(2) = 0 !! where descriptions go, and how much fits
    integer :: active = 1
  end type append_file_t

contains

  !> Number of the object at a path, 1 for the root (empty path), 0 if there is none
  pure integer function find_object(file, path) result(number)
    type(append_file_t), intent(in) :: file
    character(len=*), intent(in) :: path
    integer :: first, last, k, parent
    number = 1
    first = 1
    do while (first <= len(path))
      last = index(path(first:), "/") - 1
      if (last < 0) last = len(path) - first + 1
      parent = number
      number = 0
      do k = 2, file%objects
        if (file%object(k)%parent /= parent) cycle
        if (file%object(k)%name == path(first:first + last - 1)) number = k
      end do
      if (number == 0) return
      first = first + last + 1
    end do
  end function find_object

  subroutine new_object(file, path, kind, number, error)
    type(append_file_t), intent(inout) :: file
    character(len=*), intent(in) :: path
    integer, intent(in) :: kind
    integer, intent(out) :: number
    type(error_t), allocatable, intent(out) :: error
    type(object_t), allocatable :: wider(:)
    integer :: slash, parent
    number = 0
    call check_usable(file, error)
    if (allocated(error)) return
    slash = index(path, "/", back=.true.)
    parent = find_object(file, path(:max(0, slash - 1)))
    if (parent > 0) then
      if (file%object(parent)%kind /= a_group) parent = 0
    end if
    if (parent == 0) then
      call raise(error, file%path//": no group to hold "//path)
    else if (find_object(file, path) > 0) then
      call raise(error, file%path//": "//path//" exists already")
    else if (len(path) == slash .or. len(path) - slash > 255) then
      call raise(error, file%path//": "//path//" is no name; it needs 1 to 255 characters after the last slash")
    end if
    if (allocated(error)) return
    if (file%objects == size(file%object)) then
      allocate (wider(2*file%objects))
      wider(:file%objects) = file%object
      call move_alloc(wider, file%object)
    end if
    file%objects = file%objects + 1
    number = file%objects
    file%object(number)%kind = kind
    file%object(number)%parent = parent
    file%object(number)%name = path(slash + 1:)
  end subroutine new_object

  subroutine check_usable(file, error)
    type(append_file_t), intent(in) :: file
    type(error_t), allocatable, intent(out) :: error
    if (.not. file%is_open) then
      call raise(error, "a file that is not open cannot be written")
    else if (allocated(file%failure)) then
      call raise(error, file%failure)
    end if
  end subroutine check_usable

  !> Give away the next bytes of the file, at a multiple of eight
  pure subroutine take_room(file, bytes, address)
    type(append_file_t), intent(inout) :: file
    integer(i8), intent(in) :: bytes
    integer(i8), intent(out) :: address
    address = 8*((file%used + 7)/8)
    file%used = address + bytes
  end subroutine take_room

  !> Write bytes that all ranks know: rank 0 does it for all
  subroutine put_on_disk(file, address, text)
    type(append_file_t), intent(inout) :: file
    integer(i8), intent(in) :: address
    character(len=*), intent(in), target :: text
    if (this_rank == 0) call put_bytes(file, address, c_loc(text), len(text, kind=i8))
  end subroutine put_on_disk

  !> Write bytes of this rank, unless something went wrong since the last commit
  subroutine put_bytes(file, address, buffer, bytes)
    type(append_file_t), intent(inout) :: file
    integer(i8), intent(in) :: address, bytes
    type(c_ptr), intent(in) :: buffer
    if (.not. allocated(file%trouble)) call write_at(file%raw, address, buffer, bytes, file%trouble)
  end subroutine put_bytes

  !> Put a value at the end of a list
  pure subroutine push(list, n, value)
    integer(i8), allocatable, intent(inout) :: list(:)
    integer(i8), intent(in) :: n !! entries before
    integer(i8), intent(in) :: value
    integer(i8), allocatable :: wider(:)
    if (n == size(list, kind=i8)) then
      allocate (wider(2*n))
      wider(:n) = list
      call move_alloc(wider, list)
    end if
    list(n + 1) = value
  end subroutine push

end module gimp_append_state
