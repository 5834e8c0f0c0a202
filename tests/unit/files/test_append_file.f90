!> What is committed can be read by the HDF5 library, what is not committed is not seen
program test_append_file
  use gimp_common_kinds, only: dp, i8
  use gimp_error, only: error_t
  use gimp_file_system, only: file_exists, file_bytes, delete_file
  use gimp_hdf5, only: hdf5_file_t, open_hdf5, close_hdf5, read_dataset, dataset_shape, read_attribute, read_text, &
    has_attribute, has_dataset
  use gimp_hdf5_format, only: lookup3
  use gimp_append_file, only: append_file_t, create_append_file, commit_append_file, close_append_file, make_group, &
    make_table, append_rows, put_text, set_attribute, table_rows, stored_real32, stored_real64, stored_int64, &
    carry_append_file, reopen_append_file, sync_append_file
  use gimp_parcel, only: parcel_t, pack_parcel, unpack_parcel, is_used_up
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)
  character(len=*), parameter :: name = "test_append_file.h5"
  type(error_t), allocatable :: error
  call begin_suite("append_file")
  call delete_file(name, error)
  call checksum()
  call only_commits_count()
  call deep_index()
  call reopened()
  call reopened_too_short()
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

  !> A file that went on after its state was packed is cut back to it and continued, again and again; readers find what a
  !> file has that was never interrupted
  subroutine reopened()
    integer, parameter :: pieces(8) = [3, 1, 127, 2, 8000, 1, 300, 66] ! chunks half full, leaves just full, three levels
    type(append_file_t) :: file, again
    type(parcel_t) :: packed
    integer(i8) :: used
    integer :: one, two, k, n, after
    call create_append_file(name, .true., file, error)
    call make_group(file, "g", error)
    call make_table(file, "g/one", stored_real64, 1, 2_i8, one, error)
    call make_table(file, "g/two", stored_int64, 3, 5_i8, two, error)
    call put_text(file, "text", "kept", error)
    n = 0
    do k = 1, size(pieces)
      call append_numbers(file, one, two, n, pieces(k))
      n = n + pieces(k)
      call set_attribute(file, "g", "rows", n, error)
      call commit_append_file(file, error)
      call sync_append_file(file, error)
      used = file_bytes(name)
      call pack_parcel(packed)
      call carry_append_file(file, packed)
      ! the run that wrote goes on for a while, in vain
      after = merge(500, 1, modulo(k, 2) == 0)
      call append_numbers(file, one, two, -20*n, after)
      call set_attribute(file, "g", "later", "a text that needs room of its own", error)
      if (k /= 5) call commit_append_file(file, error)
      if (k == 4) call put_text(file, "later", repeat("long ", 1000), error)
      call close_append_file(file, error)
      call sound("the run in vain")
      call unpack(packed, again)
      call reopen_append_file(name, "second", again, error)
      call sound("reopen")
      call check_true(file_bytes(name) < used + 8*8192, "the file is cut back")
      call check_content(n, "reopened")
      if (k == size(pieces)) exit
      file = again
    end do
    call close_append_file(again, error)
    call sound("close")
    call check_content(n, "closed")
  end subroutine reopened

  subroutine unpack(packed, file)
    type(parcel_t), intent(in) :: packed
    type(append_file_t), intent(out) :: file
    type(parcel_t) :: parcel
    call unpack_parcel(parcel, packed%words(:packed%n))
    call carry_append_file(file, parcel)
    call check_true(is_used_up(parcel), "the state comes out of its parcel")
  end subroutine unpack

  subroutine append_numbers(file, one, two, first, n)
    type(append_file_t), intent(inout) :: file
    integer, intent(in) :: one, two, first, n
    integer :: i, j
    call append_rows(file, one, [(real(first + i, dp), i=1, n)], error)
    call sound("append")
    call append_rows(file, two, reshape([((int(3*(first + i) + j, i8), j=1, 3), i=1, n)], [3, n]), error)
    call sound("append")
  end subroutine append_numbers

  subroutine check_content(n, what)
    integer, intent(in) :: n
    character(len=*), intent(in) :: what
    type(hdf5_file_t) :: reader
    real(dp), allocatable :: vector(:)
    integer(i8), allocatable :: matrix(:, :)
    character(len=:), allocatable :: text
    integer(i8) :: rows
    integer :: i
    call open_hdf5(name, "read", reader, error)
    call sound(what)
    call read_dataset(reader, "g/one", vector, error)
    call sound(what)
    call check(vector, [(real(i, dp), i=1, n)], 0.0_dp, what//": a vector")
    call read_dataset(reader, "g/two", matrix, error)
    call sound(what)
    call check_true(all(reshape(matrix, [size(matrix)]) == [(int(i, i8), i=4, 3*n + 3)]), what//": a matrix")
    call read_attribute(reader, "g", "rows", rows, error)
    call check_true(rows == n, what//": an attribute")
    call check_true(.not. has_attribute(reader, "g", "later"), what//": what came later is gone")
    call check_true(.not. has_dataset(reader, "later"), what//": also a dataset")
    call read_attribute(reader, "", "lineage", text, error)
    call check(text, "second", what//": who wrote it")
    call read_text(reader, "text", text, error)
    call check(text, "kept", what//": a text")
    call close_hdf5(reader, error)
  end subroutine check_content

  subroutine reopened_too_short()
    type(append_file_t) :: file, again
    type(parcel_t) :: packed
    integer :: one
    call create_append_file(name, .true., file, error)
    call make_table(file, "one", stored_real64, 1, 100_i8, one, error)
    call append_rows(file, one, [1.0_dp, 2.0_dp], error)
    call commit_append_file(file, error)
    call pack_parcel(packed)
    call carry_append_file(file, packed)
    call close_append_file(file, error)
    call create_append_file(name, .true., file, error)
    call close_append_file(file, error)
    call unpack(packed, again)
    call reopen_append_file(name, "", again, error)
    call check_true(allocated(error), "a file shorter than its state is refused")
    call delete_file(name, error)
    call unpack(packed, again)
    call reopen_append_file(name, "", again, error)
    call check_true(allocated(error), "a file that is gone is refused")
    call create_append_file(name, .true., file, error)
    call make_table(file, "one", stored_real64, 1, 100_i8, one, error)
    call append_rows(file, one, [1.0_dp], error)
    call close_append_file(file, error) ! for the tests below
  end subroutine reopened_too_short

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
