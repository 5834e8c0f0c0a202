!> History, CSV, scene and summary hold what they were given
program test_history
  use gimp_common_kinds, only: dp, i8
  use gimp_error, only: error_t
  use gimp_file_system, only: delete_file
  use gimp_hdf5, only: hdf5_file_t, open_hdf5, close_hdf5, read_dataset, read_attribute, read_text
  use gimp_output_file, only: output_file_t, open_output, commit_output, close_output, carry_output, &
    reopen_output
  use gimp_parcel, only: parcel_t, pack_parcel, unpack_parcel, is_used_up
  use gimp_history, only: history_t, open_history, append_row, commit_history, close_history, carry_history, &
    reopen_csv
  use gimp_summary, only: write_scene, put_summary
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)
  character(len=*), parameter :: name = "test_history.vtkhdf", csv = "test_history.csv"
  type(error_t), allocatable :: error
  call begin_suite("history")
  call rows_come_back()
  call scene_and_summary()
  call goes_on()
  call delete_file(name, error)
  call delete_file(csv, error)
  call end_suite()

contains

  subroutine rows_come_back()
    integer, parameter :: many = 3000 !! more than are gathered in memory
    type(output_file_t) :: output
    type(history_t) :: history
    integer :: k
    call open_output(name, .true., output, error)
    call open_history(output, ["step  ", "energy"], ["1", "J"], history, error, csv)
    call check_true(.not. allocated(error), "open")
    do k = 1, many
      call append_row(output, history, [real(k, dp), 1.0_dp/k], error)
      if (allocated(error)) call check_true(.false., error%message)
      if (k == 1500) call commit_history(output, history, error)
    end do
    call check_table(1500 + 1024) ! rows that fill the memory are committed without being asked
    call append_row(output, history, [1.0_dp], error)
    call check_true(allocated(error), "a row has a value per column")
    call close_history(output, history, error)
    call check_table(many)
    call close_output(output, error)
    call check_csv(many)
    call open_output(name, .true., output, error)
    call open_history(output, ["a", "a"], ["1", "1"], history, error)
    call check_true(allocated(error), "a column exists once")
    call close_output(output, error)
  end subroutine rows_come_back

  !> Rows that came after the state was packed are gone, from the table and from the CSV file; then it goes on
  subroutine goes_on()
    type(output_file_t) :: output, output_again
    type(history_t) :: history, history_again
    type(parcel_t) :: packed, parcel
    integer :: k
    call open_output(name, .true., output, error)
    call open_history(output, ["step  ", "energy"], ["1", "J"], history, error, csv)
    do k = 1, 1700
      call append_row(output, history, [real(k, dp), 1.0_dp/k], error)
    end do
    call commit_history(output, history, error)
    call pack_parcel(packed)
    call carry_history(history, packed)
    call carry_output(output, packed)
    do k = 1, 1100
      call append_row(output, history, [-1.0_dp, -1.0_dp], error)
    end do
    call close_history(output, history, error)
    call close_output(output, error)
    call check_true(.not. allocated(error), "a run that goes on in vain")
    call unpack_parcel(parcel, packed%words(:packed%n))
    call carry_history(history_again, parcel)
    call carry_output(output_again, parcel)
    call check_true(is_used_up(parcel), "the state of a history comes out of its parcel")
    call reopen_output(name, "me", output_again, error)
    call reopen_csv(history_again, csv, error)
    call check_true(.not. allocated(error), "reopen")
    call check_table(1700)
    do k = 1701, 3000
      call append_row(output_again, history_again, [real(k, dp), 1.0_dp/k], error)
    end do
    call close_history(output_again, history_again, error)
    call close_output(output_again, error)
    call check_table(3000)
    call check_csv(3000)
    call delete_file(csv, error)
    call reopen_csv(history_again, csv, error)
    call check_true(allocated(error), "a CSV file that is gone is told")
  end subroutine goes_on

  subroutine check_table(rows)
    integer, intent(in) :: rows
    type(hdf5_file_t) :: file
    real(dp), allocatable :: energy(:)
    character(len=:), allocatable :: unit
    integer(i8) :: told
    integer :: k
    call open_hdf5(name, "read", file, error)
    call read_dataset(file, "history/energy", energy, error)
    call read_attribute(file, "history", "rows", told, error)
    call read_attribute(file, "history/energy", "unit", unit, error)
    call close_hdf5(file, error)
    call check(int(told), rows, "committed rows")
    call check(energy, [(1.0_dp/k, k=1, rows)], 0.0_dp, "a column")
    call check(unit, "J", "unit of a column")
  end subroutine check_table

  subroutine check_csv(rows)
    integer, intent(in) :: rows
    character(len=80) :: line
    real(dp) :: values(2)
    integer :: unit, k, status
    open (newunit=unit, file=csv, action="read", status="old")
    read (unit, "(a)") line
    call check(trim(line), "step,energy", "header of the CSV file")
    do k = 1, rows
      read (unit, *, iostat=status) values
      if (status /= 0) exit
      if (values(2) /= 1.0_dp/k) exit
    end do
    call check(k - 1, rows, "rows of the CSV file, with all digits")
    close (unit)
  end subroutine check_csv

  subroutine scene_and_summary()
    type(output_file_t) :: output
    type(hdf5_file_t) :: file
    character(len=:), allocatable :: text
    real(dp) :: value
    integer(i8) :: number
    call open_output(name, .true., output, error)
    call write_scene(output, "&time end = 1 /", repeat("&time end = 1.0 /"//new_line("a"), 1000), error)
    call check_true(.not. allocated(error), "write the scene")
    call put_summary(output, "status", "running", error)
    call commit_output(output, error)
    call put_summary(output, "status", "done", error)
    call put_summary(output, "steps", 12345678901_i8, error)
    call put_summary(output, "threads", 2, error)
    call put_summary(output, "time", 0.1_dp, error)
    call check_true(.not. allocated(error), "write the summary")
    call close_output(output, error)
    call open_hdf5(name, "read", file, error)
    call read_text(file, "scene/input", text, error)
    call check(text, "&time end = 1 /", "the input as read")
    call read_text(file, "scene/complete", text, error)
    call check(len(text), 18000, "the complete scene")
    call read_attribute(file, "summary", "status", text, error)
    call check(text, "done", "status")
    call read_attribute(file, "summary", "steps", number, error)
    call check_true(number == 12345678901_i8, "steps")
    call read_attribute(file, "summary", "time", value, error)
    call check(value, 0.1_dp, 0.0_dp, "time")
    call close_hdf5(file, error)
  end subroutine scene_and_summary

end program test_history
