!> What every part of the HDF5 wrapping needs: an open file, whether something is in it, and how a failure is told
module gimp_hdf5_base
  use hdf5
  use gimp_common_kinds, only: dp, i8
  use, intrinsic :: iso_fortran_env, only: real32, int32
  use gimp_error, only: error_t, raise
  implicit none(type, external)
  private
  public :: hdf5_file_t, has_dataset, exists, object_path, complain, file_type, memory_type

  !> An open file
  type :: hdf5_file_t
    character(len=:), allocatable :: path
    integer(hid_t) :: id = -1
  end type hdf5_file_t

contains

  !> Whether something of that path is in the file
  logical function has_dataset(file, path)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path
    integer(hid_t) :: dataset
    integer :: status
    has_dataset = exists(file, path)
    if (.not. has_dataset) return
    call h5dopen_f(file%id, path, dataset, status)
    has_dataset = status == 0
    if (has_dataset) call h5dclose_f(dataset, status)
  end function has_dataset

  !> The library asks about one link at a time and fails when a group on the way is missing
  logical function exists(file, path)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path
    integer :: last, status, from
    exists = .true.
    from = 1
    do while (exists .and. from <= len(path))
      last = index(path(from:), "/")
      if (last == 0) last = len(path) - from + 2
      if (last > 1) then
        call h5lexists_f(file%id, path(:from + last - 2), exists, status)
        exists = exists .and. status == 0
      end if
      from = from + last
    end do
  end function exists

  pure function object_path(path) result(name)
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: name
    name = path
    if (len(path) == 0) name = "/"
  end function object_path

  subroutine complain(file, status, what, error)
    type(hdf5_file_t), intent(in) :: file
    integer, intent(in) :: status
    character(len=*), intent(in) :: what
    type(error_t), allocatable, intent(out) :: error
    if (status < 0) call raise(error, file%path//": "//what//" failed")
  end subroutine complain

  !> File type of a kind of number: always little-endian
  integer(hid_t) function file_type(name)
    character(len=*), intent(in) :: name
    select case (name)
    case ("double")
      file_type = h5t_ieee_f64le
    case ("single")
      file_type = h5t_ieee_f32le
    case ("int64")
      file_type = h5t_std_i64le
    case default
      file_type = h5t_std_i32le
    end select
  end function file_type

  !> Memory type of a kind of number
  integer(hid_t) function memory_type(name)
    character(len=*), intent(in) :: name
    select case (name)
    case ("double")
      memory_type = h5kind_to_type(dp, h5_real_kind)
    case ("single")
      memory_type = h5kind_to_type(real32, h5_real_kind)
    case ("int64")
      memory_type = h5kind_to_type(i8, h5_integer_kind)
    case default
      memory_type = h5kind_to_type(int32, h5_integer_kind)
    end select
  end function memory_type

end module gimp_hdf5_base
