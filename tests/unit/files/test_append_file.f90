!> What is committed can be read by the HDF5 library, what is not committed is not seen
program test_append_file
  use gimp_common_kinds, only: dp, i8
  use gimp_error, only: error_t
  use gimp_file_system, only: file_exists, delete_file
  use gimp_hdf5, only: hdf5_file_t, open_hdf5, close_hdf5, read_dataset, dataset_shape, read_attribute, read_text
  use gimp_hdf5_format, only: lookup3
  use gimp_append_file, only: append_file_t, create_append_file, commit_append_file, close_append_file, make_group, &
    make_table, append_rows, put_text, set_attribute, table_rows, stored_real32, stored_real64, stored_int64
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)
  character(len=*), parameter :: name = "test_append_file.h5"
  type(error_t), allocatable :: error
  call begin_suite("append_file")
  call delete_file(name, error)
  call checksum()
  call only_commits_count()
  call deep_index()
  call wrong_use()
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

  !> Values that Jenkins published with his function
  subroutine checksum()
    call check_true(lookup3("") == int(z"DEADBEEF", i8), "lookup3 of nothing")
    call check_true(lookup3("Four score and seven years ago") == int(z"17770551", i8), "lookup3 of the published sentence")
  end subroutine checksum

  subroutine only_commits_count()
    type(append_file_t) :: file
    type(hdf5_file_t) :: reader
    integer :: points, counts
    real(dp), allocatable :: matrix(:, :)
    integer(i8), allocatable :: numbers(:)
    integer(i8) :: rows
    real(dp) :: value
    character(len=:), allocatable :: text
    integer :: k
    call create_append_file(name, .false., file, error)
    call sound("create")
    call make_group(file, "group", error)
    call make_table(file, "group/points", stored_real32, 3, 10_i8, points, error)
    call make_table(file, "counts", stored_int64, 1, 4_i8, counts, error)
    call append_rows(file, points, reshape([(real(k, dp), k=1, 75)], [3, 25]), error)
    call append_rows(file, counts, [1_i8, 2_i8**40], error)
    call set_attribute(file, "group", "time", 0.1_dp, error)
    call set_attribute(file, "", "note", "root", error)
    call put_text(file, "group/text", "several"//new_line("a")//"lines", error)
    call sound("fill")
    call check_true(.not. file_exists(name), "before the first commit the file does not have its name")
    call commit_append_file(file, error)
    call sound("commit")
    call check_true(file_exists(name), "the first commit gives the name")
    call check_true(.not. file_exists(name//".part"), "and takes the temporary one")
    call append_rows(file, points, reshape([(1.0e300_dp, k=1, 30)], [3, 10]), error)
    call set_attribute(file, "group", "time", 0.2_dp, error)
    call open_hdf5(name, "read", reader, error)
    call sound("read while it is being written")
    call read_dataset(reader, "group/points", matrix, error)
    call sound("read a table")
    call check(reshape(matrix, [size(matrix)]), [(real(k, dp), k=1, 75)], 0.0_dp, "committed rows, and only those")
    call read_dataset(reader, "counts", numbers, error)
    call check_true(all(numbers == [1_i8, 2_i8**40]), "long integers")
    call read_attribute(reader, "group", "time", value, error)
    call check(value, 0.1_dp, 0.0_dp, "attribute as committed")
    call read_attribute(reader, "", "note", text, error)
    call check(text, "root", "attribute of the root")
    call read_text(reader, "group/text", text, error)
    call check(text, "several"//new_line("a")//"lines", "text")
    call close_hdf5(reader, error)
    call close_append_file(file, error)
    call sound("close")
    call open_hdf5(name, "read", reader, error)
    call read_dataset(reader, "group/points", matrix, error)
    call check_true(size(matrix, 2) == 35, "closing commits")
    call check_true(all(matrix(:, 26:) > huge(1.0_dp)), "too large for single precision becomes infinite")
    call read_attribute(reader, "group", "time", value, error)
    call check(value, 0.2_dp, 0.0_dp, "attribute replaced")
    call close_hdf5(reader, error)
    rows = table_rows(file, points)
    call check_true(rows == 35, "rows are counted")
  end subroutine only_commits_count

  !> Chunks of two rows force an index of three levels (more than 64**2 chunks), committed at awkward moments
  subroutine deep_index()
    integer, parameter :: pieces(9) = [1, 127, 1, 126, 2, 8000, 3, 37, 4000]
    type(append_file_t) :: file
    type(hdf5_file_t) :: reader
    real(dp), allocatable :: vector(:), matrix(:, :)
    real(dp), allocatable :: expected(:, :)
    integer :: one, two, k, n
    allocate (expected(2, 20000))
    expected(:, :) = reshape([(real(k, dp), k=1, 40000)], [2, 20000])
    call create_append_file(name, .true., file, error)
    call sound("overwrite")
    call make_table(file, "one", stored_real64, 1, 2_i8, one, error)
    call make_table(file, "two", stored_real64, 2, 2_i8, two, error)
    n = 0
    do k = 1, size(pieces)
      call append_rows(file, one, expected(1, n + 1:n + pieces(k)), error)
      call append_rows(file, two, expected(:, n + 1:n + pieces(k)), error)
      call commit_append_file(file, error)
      call sound("commit")
      n = n + pieces(k)
      call open_hdf5(name, "read", reader, error)
      call read_dataset(reader, "one", vector, error)
      call check(vector, expected(1, :n), 0.0_dp, "vector behind an index of several levels")
      call read_dataset(reader, "two", matrix, error)
      call check(reshape(matrix, [size(matrix)]), reshape(expected(:, :n), [2*n]), 0.0_dp, &
        "matrix behind an index of several levels")
      call close_hdf5(reader, error)
    end do
    call close_append_file(file, error)
    call sound("close")
  end subroutine deep_index

  subroutine wrong_use()
    type(append_file_t) :: file
    type(hdf5_file_t) :: reader
    real(dp), allocatable :: vector(:)
    integer :: table
    call create_append_file(name, .false., file, error)
    call check_true(allocated(error), "an existing file is refused")
    call create_append_file("no/such/folder/a.h5", .true., file, error)
    call check_true(allocated(error), "a folder that is not there is told")
    call create_append_file(name, .true., file, error)
    call make_table(file, "nowhere/table", stored_real64, 1, 10_i8, table, error)
    call check_true(allocated(error), "a table needs its group")
    call make_table(file, "table", stored_real64, 2, 10_i8, table, error)
    call append_rows(file, table, [1.0_dp], error)
    call check_true(allocated(error), "rows must have the components of the table")
    call append_rows(file, table, reshape([1_i8, 2_i8], [2, 1]), error)
    call check_true(allocated(error), "a table of reals takes no integers")
    call set_attribute(file, "nothing", "a", 1, error)
    call check_true(allocated(error), "nothing has no attributes")
    call make_group(file, "table", error)
    call check_true(allocated(error), "a table is no group")
    call open_hdf5(name, "read", reader, error)
    call read_dataset(reader, "one", vector, error)
    call sound("the older file stays until the new one is committed")
    call close_hdf5(reader, error)
    call close_append_file(file, error)
    call sound("mistakes of the caller do not spoil the file")
    call append_rows(file, table, reshape([1.0_dp, 2.0_dp], [2, 1]), error)
    call check_true(allocated(error), "a closed file takes nothing")
  end subroutine wrong_use

end program test_append_file
