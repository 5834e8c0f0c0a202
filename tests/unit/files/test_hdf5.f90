!> What goes into an HDF5 file comes out, and what fails says so
program test_hdf5
  use, intrinsic :: iso_fortran_env, only: real32, int32
  use gimp_common_kinds, only: dp, i8
  use gimp_error, only: error_t
  use gimp_file_system, only: delete_file
  use gimp_hdf5, only: hdf5_file_t, open_hdf5, close_hdf5, flush_hdf5, create_group, write_dataset, append_dataset, &
    read_dataset, has_dataset, dataset_shape, members_of_group, write_attribute, read_attribute, has_attribute, write_text, read_text
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)
  character(len=*), parameter :: name = "test_hdf5.h5"
  type(error_t), allocatable :: error
  call begin_suite("hdf5")
  call delete_file(name, error)
  call datasets_come_back()
  call growing_datasets()
  call attributes_and_texts()
  call members()
  call failures_are_told()
  call delete_file(name, error)
  call end_suite()

contains

  subroutine sound(what)
    character(len=*), intent(in) :: what
    if (allocated(error)) then
      call check_true(.false., what//": "//error%message)
    else
      call check_true(.true., what)
    end if
  end subroutine sound

  subroutine fails(what, part)
    character(len=*), intent(in) :: what, part !! part: what the message must mention
    call check_true(allocated(error), what)
    if (.not. allocated(error)) return
    call check_true(index(error%message, part) > 0, what//" mentions "//part//": "//error%message)
    call check_true(index(error%message, ".h5") > 0, what//" names the file: "//error%message)
  end subroutine fails

  subroutine datasets_come_back()
    type(hdf5_file_t) :: file
    real(dp), allocatable :: vector(:), matrix(:, :)
    integer(i8), allocatable :: numbers(:), extents(:)
    call open_hdf5(name, "create", file, error)
    call sound("create")
    call create_group(file, "group", error)
    call create_group(file, "group", error)
    call sound("a group may be there already")
    call write_dataset(file, "group/vector", [1.0_dp, 1.0_dp/3.0_dp, -0.0_dp], error)
    call sound("write a vector")
    call write_dataset(file, "matrix", reshape([1.0_real32, 2.0_real32, 3.0_real32, 4.0_real32, 5.0_real32, 6.0_real32], &
      [2, 3]), error)
    call write_dataset(file, "numbers", [huge(1_i8), -huge(1_i8) - 1_i8], error)
    call write_dataset(file, "small", [7_int32], error)
    call sound("write numbers")
    call close_hdf5(file, error)
    call open_hdf5(name, "read", file, error)
    call sound("open for reading")
    call read_dataset(file, "group/vector", vector, error)
    call check(vector, [1.0_dp, 1.0_dp/3.0_dp, -0.0_dp], 0.0_dp, "a vector comes back bit for bit")
    call read_dataset(file, "matrix", matrix, error)
    call check(reshape(matrix, [6]), [1.0_dp, 2.0_dp, 3.0_dp, 4.0_dp, 5.0_dp, 6.0_dp], 0.0_dp, "single is read as double")
    call dataset_shape(file, "matrix", extents, error)
    call check_true(all(extents == [2_i8, 3_i8]), "shape in Fortran order")
    call read_dataset(file, "numbers", numbers, error)
    call check_true(all(numbers == [huge(1_i8), -huge(1_i8) - 1_i8]), "the largest integers come back")
    call read_dataset(file, "small", numbers, error)
    call check_true(all(numbers == [7_i8]), "short integers are read as long ones")
    call check_true(has_dataset(file, "group/vector"), "a dataset is there")
    call check_true(.not. has_dataset(file, "group"), "a group is no dataset")
    call check_true(.not. has_dataset(file, "nothing/here"), "asking below a group that is not there is no error")
    call close_hdf5(file, error)
    call sound("close")
  end subroutine datasets_come_back

  subroutine growing_datasets()
    type(hdf5_file_t) :: file
    real(dp), allocatable :: vector(:), matrix(:, :)
    real(dp) :: expected(5000)
    integer :: k
    expected = [(0.5_dp*k, k=1, 5000)]
    call open_hdf5(name, "append", file, error)
    call append_dataset(file, "grows", expected(:0), error)
    do k = 1, 5000, 625
      call append_dataset(file, "grows", expected(k:k + 624), error)
    end do
    call flush_hdf5(file, error)
    call sound("append in pieces")
    call read_dataset(file, "grows", vector, error)
    call check(vector, expected, 0.0_dp, "pieces make the whole")
    call append_dataset(file, "rows", reshape([1.0_dp, 2.0_dp, 3.0_dp], [3, 1]), error)
    call append_dataset(file, "rows", reshape([4.0_dp, 5.0_dp, 6.0_dp], [3, 1]), error)
    call read_dataset(file, "rows", matrix, error)
    call check(reshape(matrix, [6]), [(real(k, dp), k=1, 6)], 0.0_dp, "a matrix grows along its last dimension")
    call read_dataset(file, "rows", matrix, error, rows=[2_i8, 2_i8])
    call check(reshape(matrix, [3]), [4.0_dp, 5.0_dp, 6.0_dp], 0.0_dp, "one row of a matrix")
    call read_dataset(file, "grows", vector, error, rows=[620_i8, 4000_i8])
    call check(vector, expected(620:4000), 0.0_dp, "rows of a vector in pieces")
    call read_dataset(file, "grows", vector, error, rows=[5001_i8, 5000_i8])
    call sound("no row at all can be read")
    call check(size(vector), 0, "no row at all")
    call read_dataset(file, "grows", vector, error, rows=[4999_i8, 5001_i8])
    call fails("more rows than there are", "has 5000 rows; 4999 to 5001 were asked for")
    call append_dataset(file, "rows", reshape([4.0_dp, 5.0_dp], [2, 1]), error)
    call fails("appending rows of another length", "rows")
    call append_dataset(file, "rows", [1.0_dp], error)
    call fails("appending a vector to a matrix", "rows")
    call append_dataset(file, "matrix", reshape([4.0_dp, 5.0_dp], [2, 1]), error)
    call fails("appending to a dataset of fixed size", "matrix")
    call close_hdf5(file, error)
  end subroutine growing_datasets

  subroutine attributes_and_texts()
    type(hdf5_file_t) :: file
    character(len=:), allocatable :: text
    character(len=*), parameter :: words = "Gr"//char(195)//char(188)//char(195)//char(159)//"e "
    real(dp) :: value
    integer(i8) :: number
    call open_hdf5(name, "append", file, error)
    call write_attribute(file, "", "time", 1.0_dp, error)
    call write_attribute(file, "/", "time", 0.1_dp, error)
    call write_attribute(file, "group", "count", 2_i8**40, error)
    call write_attribute(file, "group", "unit", words, error)
    call write_attribute(file, "group", "empty", "", error)
    call write_text(file, "text", repeat(words//new_line("a"), 5000), error)
    call sound("write attributes and text")
    call read_attribute(file, "", "time", value, error)
    call check(value, 0.1_dp, 0.0_dp, "an attribute is replaced")
    call read_attribute(file, "group", "count", number, error)
    call check_true(number == 2_i8**40, "a long attribute")
    call read_attribute(file, "group", "unit", text, error)
    call check(text, words, "a text attribute keeps bytes and blanks")
    call check(len(text), len(words), "length of a text attribute")
    call read_attribute(file, "group", "empty", text, error)
    call check(len(text), 0, "an empty text attribute")
    call read_text(file, "text", text, error)
    call check_true(text == repeat(words//new_line("a"), 5000) .and. len(text) == 45000, "a long text comes back")
    call write_text_of_any_length(file, words)
    call read_attribute(file, "group", "varies", text, error)
    call sound("read a text of any length, as h5py writes it")
    call check(text, words, "a text of any length keeps bytes and blanks")
    call check_true(has_attribute(file, "group", "unit"), "an attribute that is there")
    call check_true(.not. has_attribute(file, "nothing", "unit"), "an attribute of nothing")
    call read_attribute(file, "group", "nothing", value, error)
    call fails("reading an attribute that is not there", "nothing")
    call read_attribute(file, "group", "unit", value, error)
    call fails("reading a text as a number", "unit")
    call read_attribute(file, "group", "count", text, error)
    call fails("reading a number as a text", "count")
    call close_hdf5(file, error)
  end subroutine attributes_and_texts

  !> Attribute "varies" of "group"
  subroutine write_text_of_any_length(file, words)
    use, intrinsic :: iso_c_binding, only: c_loc, c_ptr, c_char, c_null_char
    use hdf5
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: words
    character(kind=c_char, len=:), allocatable, target :: text
    type(c_ptr), target :: place
    integer(hid_t) :: group, space, type, attribute
    integer :: status
    text = words//c_null_char
    place = c_loc(text)
    call h5gopen_f(file%id, "group", group, status)
    call h5screate_f(h5s_scalar_f, space, status)
    call h5tcopy_f(h5t_string, type, status)
    call h5acreate_f(group, "varies", type, space, attribute, status)
    call h5awrite_f(attribute, type, c_loc(place), status)
    call h5aclose_f(attribute, status)
    call h5gclose_f(group, status)
  end subroutine write_text_of_any_length

  !> What is in a group, in alphabetical order
  subroutine members()
    type(hdf5_file_t) :: file
    character(len=64), allocatable :: names(:)
    call open_hdf5(name, "read", file, error)
    call members_of_group(file, "/", names)
    call check_true(size(names) > 3, "members of the root")
    call check(trim(names(1)), "group", "the first member of the root")
    call members_of_group(file, "group", names)
    call check(size(names), 1, "members of a group")
    call check(trim(names(1)), "vector", "the name of a member")
    call members_of_group(file, "nothing", names)
    call check(size(names), 0, "no members of a group that is not there")
    call close_hdf5(file, error)
  end subroutine members

  subroutine failures_are_told()
    type(hdf5_file_t) :: file
    real(dp), allocatable :: vector(:)
    integer(i8), allocatable :: numbers(:)
    integer :: unit
    call open_hdf5(name, "create", file, error)
    call fails("creating a file that is there", "overwrit")
    call open_hdf5("no/such/folder/a.h5", "create", file, error)
    call fails("creating in a folder that is not there", "folder")
    call open_hdf5("not_there.h5", "read", file, error)
    call fails("reading a file that is not there", "no such file")
    open (newunit=unit, file="plain_text.h5", status="replace")
    write (unit, "(a)") "this is a plain text, no HDF5 file at all"
    close (unit)
    call open_hdf5("plain_text.h5", "read", file, error)
    call fails("reading a plain text", "not an HDF5 file")
    call delete_file("plain_text.h5", error)
    call open_hdf5(name, "read", file, error)
    call read_dataset(file, "nothing", vector, error)
    call fails("reading a dataset that is not there", "nothing")
    call read_dataset(file, "matrix", vector, error)
    call fails("reading a matrix as a vector", "matrix")
    call read_dataset(file, "group/vector", numbers, error)
    call fails("reading reals as integers", "integers")
    call write_dataset(file, "new", [1.0_dp], error)
    call fails("writing to a file opened for reading", "new")
    call close_hdf5(file, error)
    call close_hdf5(file, error)
    call sound("closing twice")
  end subroutine failures_are_told

end program test_hdf5
