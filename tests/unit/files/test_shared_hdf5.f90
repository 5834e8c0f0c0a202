!> A file that ranks write together reads as if one had written it; also run on several ranks
program test_shared_hdf5
  use, intrinsic :: iso_fortran_env, only: int32, real32
  use gimp_common_kinds, only: dp, i8
  use gimp_error, only: error_t
  use gimp_ranks, only: this_rank, ranks, start_ranks, end_ranks, wait_for_ranks
  use gimp_file_system, only: delete_file, file_exists
  use gimp_hdf5, only: hdf5_file_t, open_hdf5, close_hdf5, create_group, read_dataset, dataset_shape, write_attribute, &
    read_attribute, write_text, read_text
  use gimp_shared_hdf5, only: shared_file_t, lay_out, announce_rows, end_layout, rows_before, write_rows, close_shared, drop_shared
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)
  character(len=*), parameter :: name = "test_shared_hdf5.h5"
  type(error_t), allocatable :: error
  call start_ranks()
  call begin_suite("shared_hdf5")
  call clear()
  call rows_come_back(0)
  call rows_come_back(512)
  call ranges()
  call mistakes_are_told()
  call clear()
  call end_suite()
  call end_ranks(0)

contains

  subroutine clear()
    call wait_for_ranks()
    if (this_rank == 0) call delete_file(name, error)
    call wait_for_ranks()
  end subroutine clear

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
  end subroutine fails

  !> Every rank has another number of rows, the last but one none; they are written in pieces
  subroutine rows_come_back(user_block)
    integer, intent(in) :: user_block
    type(shared_file_t) :: shared
    type(hdf5_file_t) :: file
    integer(i8), allocatable :: numbers(:)
    real(dp), allocatable :: values(:, :), small(:)
    character(len=:), allocatable :: text
    integer(i8) :: rows, before, total, k
    rows = 5 + 2*this_rank
    if (this_rank == ranks - 2) rows = 0
    if (user_block == 0) call lay_out(name, shared, error)
    if (user_block > 0) call lay_out(name, shared, error, user_block)
    call sound("a layout begins")
    if (this_rank == 0) call create_group(shared%file, "group", error)
    if (this_rank == 0) call write_text(shared%file, "group/words", "as ever", error)
    if (this_rank == 0) call write_attribute(shared%file, "", "step", 7, error)
    call announce_rows(shared, "group/values", "double", rows, width=3)
    call announce_rows(shared, "numbers", "int64", rows)
    call announce_rows(shared, "single", "single", rows)
    call announce_rows(shared, "empty", "int32", 0_i8, width=2)
    call end_layout(shared, error)
    call sound("and ends")
    before = rows_before(shared, "numbers")
    do k = 1, rows, 2
      call write_rows(shared, "group/values", k, values_of(before + k, min(before + k + 1, before + rows)), error)
      call sound("rows are written in pieces")
    end do
    call write_rows(shared, "numbers", 1_i8, [(before + k, k=1, rows)], error)
    call write_rows(shared, "single", 1_i8, [(0.5_real32*real(before + k, real32), k=1, rows)], error)
    call write_rows(shared, "empty", 1_i8, reshape([integer(int32) ::], [2, 0]), error)
    call sound("or at once")
    call close_shared(shared, error)
    call sound("and are on the device")

    total = 0
    do k = 0, ranks - 1
      if (k /= ranks - 2) total = total + 5 + 2*k
    end do
    call open_hdf5(name, "read", file, error)
    call sound("the library opens the file")
    call read_dataset(file, "group/values", values, error)
    call check_true(total == size(values, 2), "all rows are there")
    call check(reshape(values, [3*total]), reshape(values_of(1_i8, total), [3*total]), 0.0_dp, "in the order of ranks")
    call read_dataset(file, "numbers", numbers, error)
    call check_true(numbers(1) == 1 .and. all(numbers == [(k, k=1, total)]), "vectors as well")
    call read_dataset(file, "single", small, error)
    call check(small, [(0.5_dp*k, k=1, total)], 0.0_dp, "and single precision")
    call read_dataset(file, "empty", values, error)
    call check(size(values), 0, "an empty dataset is one")
    call read_text(file, "group/words", text, error)
    call check(text, "as ever", "texts")
    call read_attribute(file, "", "step", before, error)
    call check(int(before), 7, "attributes")
    call close_hdf5(file, error)
    call wait_for_ranks()
  end subroutine rows_come_back

  function values_of(first, last) result(values)
    integer(i8), intent(in) :: first, last
    real(dp) :: values(3, last - first + 1)
    integer(i8) :: k
    do k = first, last
      values(:, k - first + 1) = [1.0_dp, 1.0_dp/3.0_dp, -0.0_dp]*k
    end do
  end function values_of

  !> Some rows of what was written
  subroutine ranges()
    type(hdf5_file_t) :: file
    integer(i8), allocatable :: numbers(:)
    real(dp), allocatable :: values(:, :)
    integer(i8), allocatable :: extents(:)
    call open_hdf5(name, "read", file, error)
    call dataset_shape(file, "numbers", extents, error)
    call read_dataset(file, "numbers", numbers, error, rows=[2_i8, 4_i8])
    call sound("some rows")
    call check_true(size(numbers) == 3 .and. all(numbers == [2_i8, 3_i8, 4_i8]), "rows 2 to 4")
    call read_dataset(file, "group/values", values, error, rows=[extents(1), extents(1)])
    call check(values(:, 1), reshape(values_of(extents(1), extents(1)), [3]), 0.0_dp, "the last row")
    call read_dataset(file, "group/values", values, error, rows=[3_i8, 2_i8])
    call check_true(.not. allocated(error) .and. size(values, 1) == 3 .and. size(values, 2) == 0, "no rows")
    call read_dataset(file, "empty", values, error, rows=[1_i8, 0_i8])
    call check_true(.not. allocated(error) .and. size(values) == 0, "of an empty dataset")
    call read_dataset(file, "numbers", numbers, error, rows=[1_i8, extents(1) + 1])
    call fails("more rows than there are", "rows; 1 to")
    call read_dataset(file, "numbers", numbers, error, rows=[0_i8, 1_i8])
    call fails("rows before the first", "rows; 0 to 1")
    call read_dataset(file, "group/values", numbers, error, rows=[1_i8, 1_i8])
    call fails("rows of another rank", "dimensions")
    call close_hdf5(file, error)
  end subroutine ranges

  subroutine mistakes_are_told()
    type(shared_file_t) :: shared
    call lay_out("no/such/folder/a.h5", shared, error)
    call fails("a file in a folder that is not there", "folder")
    call lay_out(name, shared, error)
    call announce_rows(shared, "numbers", "int64", 2_i8)
    call announce_rows(shared, "no/group", "int64", 2_i8)
    call end_layout(shared, error)
    call fails("a dataset without its group, on every rank", "no/group")
    call drop_shared(shared)
    call lay_out(name, shared, error)
    call announce_rows(shared, "numbers", "int64", 2_i8)
    call end_layout(shared, error)
    call write_rows(shared, "others", 1_i8, [1_i8], error)
    call fails("a dataset that was not announced", "others")
    call write_rows(shared, "numbers", 2_i8, [1_i8, 2_i8], error)
    call fails("rows that would stand in those of the next rank", "rows 2 to 3")
    call write_rows(shared, "numbers", 1_i8, [1.0_dp], error)
    call fails("numbers of another kind", "numbers")
    call write_rows(shared, "numbers", 1_i8, reshape([1_i8], [1, 1]), error)
    call fails("a matrix for a vector", "numbers")
    if (this_rank == ranks - 1) call write_rows(shared, "others", 1_i8, [1_i8], error)
    if (this_rank < ranks - 1 .and. allocated(error)) deallocate (error)
    call close_shared(shared, error)
    call fails("what one rank could not write is told by all", "others")
    call check_true(file_exists(name), "the caller deletes the file")
  end subroutine mistakes_are_told

end program test_shared_hdf5
