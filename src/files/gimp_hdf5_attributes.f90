!> Attributes of the objects of an HDF5 file, and texts stored as scalar datasets
module gimp_hdf5_attributes
  use, intrinsic :: iso_c_binding, only: c_loc, c_ptr, c_char, c_null_char, c_null_ptr, c_associated, c_f_pointer
  use hdf5
  use gimp_common_kinds, only: dp, i8
  use gimp_error, only: error_t, raise
  use gimp_hdf5_base, only: hdf5_file_t, has_dataset, exists, object_path, complain, file_type, memory_type
  implicit none(type, external)
  private
  public :: write_attribute, read_attribute, has_attribute, write_text, read_text

  !> Give an object ("" or "/" for the file itself) a named value; one of that name is replaced
  interface write_attribute
    module procedure write_attribute_real, write_attribute_long, write_attribute_integer, write_attribute_text
  end interface write_attribute

  !> The named value of an object
  interface read_attribute
    module procedure read_attribute_real, read_attribute_long, read_attribute_text
  end interface read_attribute

contains

  subroutine write_attribute_real(file, path, name, value, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path, name
    real(dp), intent(in), target :: value
    type(error_t), allocatable, intent(out) :: error
    call put_attribute(file, path, name, file_type("double"), memory_type("double"), c_loc(value), error)
  end subroutine write_attribute_real

  subroutine write_attribute_long(file, path, name, value, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path, name
    integer(i8), intent(in), target :: value
    type(error_t), allocatable, intent(out) :: error
    call put_attribute(file, path, name, file_type("int64"), memory_type("int64"), c_loc(value), error)
  end subroutine write_attribute_long

  subroutine write_attribute_integer(file, path, name, value, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path, name
    integer, intent(in) :: value
    type(error_t), allocatable, intent(out) :: error
    call write_attribute_long(file, path, name, int(value, i8), error)
  end subroutine write_attribute_integer

  subroutine write_attribute_text(file, path, name, value, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path, name, value
    type(error_t), allocatable, intent(out) :: error
    character(len=:), allocatable, target :: padded
    integer(hid_t) :: type
    integer :: status
    padded = value
    if (len(value) == 0) padded = char(0) ! the format has no empty string of fixed length
    call make_text_type(len(padded), type)
    call put_attribute(file, path, name, type, type, c_loc(padded), error)
    call h5tclose_f(type, status)
  end subroutine write_attribute_text

  subroutine put_attribute(file, path, name, stored, memory, value, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path, name
    integer(hid_t), intent(in) :: stored, memory
    type(c_ptr), intent(in) :: value
    type(error_t), allocatable, intent(out) :: error
    integer(hid_t) :: object, space, attribute
    integer :: status, ignored
    logical :: there
    call h5oopen_f(file%id, object_path(path), object, status)
    if (status /= 0) then
      call raise(error, file%path//": no object "//path//" to hold attribute "//name)
      return
    end if
    call h5aexists_f(object, name, there, status)
    if (status == 0 .and. there) call h5adelete_f(object, name, status)
    call h5screate_f(h5s_scalar_f, space, ignored)
    if (status == 0) then
      call h5acreate_f(object, name, stored, space, attribute, status)
      if (status == 0) then
        call h5awrite_f(attribute, memory, value, status)
        call h5aclose_f(attribute, ignored)
      end if
    end if
    call h5sclose_f(space, ignored)
    call h5oclose_f(object, ignored)
    call complain(file, status, "writing attribute "//name//" of "//object_path(path), error)
  end subroutine put_attribute

  !> Whether an object ("" for the file itself) has a named value
  logical function has_attribute(file, path, name)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path, name
    integer :: status
    has_attribute = .false.
    if (.not. exists(file, path)) return
    call h5aexists_by_name_f(file%id, object_path(path), name, has_attribute, status)
    has_attribute = has_attribute .and. status == 0
  end function has_attribute

  subroutine read_attribute_real(file, path, name, value, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path, name
    real(dp), intent(out), target :: value
    type(error_t), allocatable, intent(out) :: error
    value = 0.0_dp
    call get_attribute(file, path, name, "double", c_loc(value), error)
  end subroutine read_attribute_real

  subroutine read_attribute_long(file, path, name, value, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path, name
    integer(i8), intent(out), target :: value
    type(error_t), allocatable, intent(out) :: error
    value = 0
    call get_attribute(file, path, name, "int64", c_loc(value), error)
  end subroutine read_attribute_long

  !> A number that is alone in its attribute (a vector of one counts, as some writers make it so)
  subroutine get_attribute(file, path, name, kind, value, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path, name, kind
    type(c_ptr), intent(in) :: value
    type(error_t), allocatable, intent(out) :: error
    type(c_ptr) :: buffer
    integer(hid_t) :: attribute, space
    integer(hsize_t) :: points
    integer :: status, ignored
    buffer = value
    call open_attribute(file, path, name, attribute, error)
    if (allocated(error)) return
    call h5aget_space_f(attribute, space, status)
    call h5sget_simple_extent_npoints_f(space, points, status)
    call h5sclose_f(space, ignored)
    status = -1
    if (points == 1) call h5aread_f(attribute, memory_type(kind), buffer, status)
    call h5aclose_f(attribute, ignored)
    call complain(file, status, "reading attribute "//name//" of "//object_path(path)//" as one number", error)
  end subroutine get_attribute

  !> A text, without the zero bytes after it; of fixed length, or of any length as other writers make it
  subroutine read_attribute_text(file, path, name, value, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path, name
    character(len=:), allocatable, intent(out) :: value
    type(error_t), allocatable, intent(out) :: error
    character(len=:), allocatable, target :: buffer
    type(c_ptr) :: pointer
    integer(hid_t) :: attribute, type
    integer(size_t) :: length
    integer :: status, ignored
    call open_attribute(file, path, name, attribute, error)
    if (allocated(error)) return
    call h5aget_type_f(attribute, type, status)
    call fixed_length(type, length)
    status = -1
    if (length > 0) then
      allocate (character(len=length) :: buffer)
      pointer = c_loc(buffer)
      call h5aread_f(attribute, type, pointer, status)
    else
      call get_text_of_any_length(attribute, type, buffer, status)
    end if
    call h5tclose_f(type, ignored)
    call h5aclose_f(attribute, ignored)
    call complain(file, status, "reading attribute "//name//" of "//object_path(path)//" as text", error)
    if (.not. allocated(error)) value = without_zeros(buffer)
  end subroutine read_attribute_text

  !> A single text that the library keeps elsewhere; status is negative if there is none
  subroutine get_text_of_any_length(attribute, type, text, status)
    integer(hid_t), intent(in) :: attribute, type
    character(len=:), allocatable, intent(out) :: text
    integer, intent(out) :: status
    type(c_ptr), target :: place
    type(c_ptr) :: pointer
    character(kind=c_char), pointer :: letter(:)
    integer(hid_t) :: space
    integer(hsize_t) :: points
    integer :: k, class
    logical :: varies
    varies = .false.
    call h5tget_class_f(type, class, status)
    if (class == h5t_string_f) call h5tis_variable_str_f(type, varies, status)
    call h5aget_space_f(attribute, space, status)
    call h5sget_simple_extent_npoints_f(space, points, status)
    status = -1
    if (varies .and. points == 1) then
      place = c_null_ptr
      pointer = c_loc(place)
      call h5aread_f(attribute, type, pointer, status)
    end if
    if (status >= 0) then
      text = ""
      if (c_associated(place)) then
        call c_f_pointer(place, letter, [huge(0)])
        k = 1
        do while (letter(k) /= c_null_char)
          k = k + 1
        end do
        text = repeat(" ", k - 1)
        do k = 1, len(text)
          text(k:k) = letter(k)
        end do
        call h5dvlen_reclaim_f(type, space, h5p_default_f, pointer, k)
      end if
    end if
    call h5sclose_f(space, k)
  end subroutine get_text_of_any_length

  subroutine open_attribute(file, path, name, attribute, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path, name
    integer(hid_t), intent(out) :: attribute
    type(error_t), allocatable, intent(out) :: error
    integer :: status
    attribute = -1
    if (has_attribute(file, path, name)) then
      call h5aopen_by_name_f(file%id, object_path(path), name, attribute, status)
      if (status == 0) return
    end if
    call raise(error, file%path//": "//object_path(path)//" has no attribute "//name)
  end subroutine open_attribute

  !> Write a text of any length as a scalar dataset; bytes are kept as they are (UTF-8)
  subroutine write_text(file, path, text, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path, text
    type(error_t), allocatable, intent(out) :: error
    character(len=:), allocatable, target :: padded
    integer(hid_t) :: type, space, dataset
    integer :: status, ignored
    padded = text
    if (len(text) == 0) padded = char(0)
    call make_text_type(len(padded), type)
    call h5screate_f(h5s_scalar_f, space, status)
    call h5dcreate_f(file%id, path, type, space, dataset, status)
    if (status == 0) then
      call h5dwrite_f(dataset, type, c_loc(padded), status)
      call h5dclose_f(dataset, ignored)
    end if
    call h5sclose_f(space, ignored)
    call h5tclose_f(type, ignored)
    call complain(file, status, "writing text "//path, error)
  end subroutine write_text

  !> Read a scalar text dataset of fixed length
  subroutine read_text(file, path, text, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path
    character(len=:), allocatable, intent(out) :: text
    type(error_t), allocatable, intent(out) :: error
    character(len=:), allocatable, target :: buffer
    type(c_ptr) :: pointer
    integer(hid_t) :: dataset, type
    integer(size_t) :: length
    integer :: status, ignored
    if (.not. has_dataset(file, path)) then
      call raise(error, file%path//": no dataset "//path)
      return
    end if
    call h5dopen_f(file%id, path, dataset, status)
    call h5dget_type_f(dataset, type, status)
    call fixed_length(type, length)
    status = -1
    if (length > 0) then
      allocate (character(len=length) :: buffer)
      pointer = c_loc(buffer)
      call h5dread_f(dataset, type, pointer, status)
    end if
    call h5tclose_f(type, ignored)
    call h5dclose_f(dataset, ignored)
    call complain(file, status, "reading "//path//" as text of fixed length", error)
    if (.not. allocated(error)) text = without_zeros(buffer)
  end subroutine read_text

  !> Bytes of a fixed-length string type, 0 for any other type
  subroutine fixed_length(type, length)
    integer(hid_t), intent(in) :: type
    integer(size_t), intent(out) :: length
    integer :: class, status
    logical :: varies
    length = 0
    call h5tget_class_f(type, class, status)
    if (class /= h5t_string_f) return
    call h5tis_variable_str_f(type, varies, status)
    if (.not. varies) call h5tget_size_f(type, length, status)
  end subroutine fixed_length

  subroutine make_text_type(length, type)
    integer, intent(in) :: length
    integer(hid_t), intent(out) :: type
    integer :: status
    call h5tcopy_f(h5t_fortran_s1, type, status)
    call h5tset_size_f(type, int(length, size_t), status)
    call h5tset_strpad_f(type, h5t_str_nullpad_f, status)
    call h5tset_cset_f(type, h5t_cset_utf8_f, status)
  end subroutine make_text_type

  pure function without_zeros(text) result(short)
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: short
    integer :: n
    n = len(text)
    do while (n > 0)
      if (text(n:n) /= char(0)) exit
      n = n - 1
    end do
    short = text(:n)
  end function without_zeros

end module gimp_hdf5_attributes
