!> Named values of the groups and tables of an append-only file
module gimp_append_attributes
  use gimp_common_kinds, only: dp, i8
  use gimp_error, only: error_t, raise
  use gimp_hdf5_format, only: stored_real64, stored_int64, stored_text
  use gimp_append_index, only: attribute_t
  use gimp_append_state, only: append_file_t, check_usable, find_object
  implicit none(type, external)
  private
  public :: set_attribute

  !> Give a group or table a named value; one of that name is replaced. All ranks give it, that of rank 0 counts
  interface set_attribute
    module procedure set_real, set_integer, set_long, set_longs, set_text
  end interface set_attribute

contains

  subroutine set_real(file, path, name, value, error)
    type(append_file_t), intent(inout) :: file
    character(len=*), intent(in) :: path, name
    real(dp), intent(in) :: value
    type(error_t), allocatable, intent(out) :: error
    call set_values(file, path, name, stored_real64, 0, transfer(value, repeat(" ", 8)), error)
  end subroutine set_real

  subroutine set_integer(file, path, name, value, error)
    type(append_file_t), intent(inout) :: file
    character(len=*), intent(in) :: path, name
    integer, intent(in) :: value
    type(error_t), allocatable, intent(out) :: error
    call set_long(file, path, name, int(value, i8), error)
  end subroutine set_integer

  subroutine set_long(file, path, name, value, error)
    type(append_file_t), intent(inout) :: file
    character(len=*), intent(in) :: path, name
    integer(i8), intent(in) :: value
    type(error_t), allocatable, intent(out) :: error
    call set_values(file, path, name, stored_int64, 0, transfer(value, repeat(" ", 8)), error)
  end subroutine set_long

  subroutine set_longs(file, path, name, value, error)
    type(append_file_t), intent(inout) :: file
    character(len=*), intent(in) :: path, name
    integer(i8), intent(in) :: value(:)
    type(error_t), allocatable, intent(out) :: error
    call set_values(file, path, name, stored_int64, size(value), transfer(value, repeat(" ", 8*size(value))), error)
  end subroutine set_longs

  subroutine set_text(file, path, name, value, error)
    type(append_file_t), intent(inout) :: file
    character(len=*), intent(in) :: path, name, value
    type(error_t), allocatable, intent(out) :: error
    if (len(value) > 32768) then
      call raise(error, file%path//": "//path//": text of attribute "//name//" is longer than 32768 bytes")
      return
    end if
    call set_values(file, path, name, stored_text, 0, value//repeat(char(0), max(0, 1 - len(value))), error)
  end subroutine set_text

  subroutine set_values(file, path, name, stored, length, values, error)
    type(append_file_t), intent(inout) :: file
    character(len=*), intent(in) :: path, name, values
    integer, intent(in) :: stored, length
    type(error_t), allocatable, intent(out) :: error
    type(attribute_t), allocatable :: wider(:)
    integer :: number, k
    call check_usable(file, error)
    if (allocated(error)) return
    number = find_object(file, path)
    if (number == 0) then
      call raise(error, file%path//": "//path//" does not exist and cannot have an attribute "//name)
      return
    end if
    associate (o => file%object(number))
      if (.not. allocated(o%attribute)) allocate (o%attribute(4))
      do k = 1, o%attributes
        if (o%attribute(k)%name == name) exit
      end do
      if (k > size(o%attribute)) then
        allocate (wider(2*size(o%attribute)))
        wider(:size(o%attribute)) = o%attribute
        call move_alloc(wider, o%attribute)
      end if
      o%attributes = max(o%attributes, k)
      o%attribute(k)%name = name
      o%attribute(k)%stored = stored
      o%attribute(k)%length = length
      o%attribute(k)%values = values
    end associate
  end subroutine set_values

end module gimp_append_attributes
