!> Writes frames and history rows without end, for tests that kill it: after each commit it prints how many frames are safe.
!> Arguments: output path, particles, 1 if their number changes from frame to frame. Values follow from the frame number.
program crash_writer
  use, intrinsic :: iso_fortran_env, only: output_unit, error_unit
  use gimp_common_kinds, only: dp, i8
  use gimp_error, only: error_t
  use gimp_output_file, only: output_file_t, open_output
  use gimp_vtkhdf, only: frames_t, open_frames, begin_frame, add_field, end_frame
  use gimp_history, only: history_t, open_history, append_row, commit_history
  use gimp_summary, only: write_scene
  implicit none(type, external)
  type(output_file_t) :: output
  type(frames_t) :: frames
  type(history_t) :: history
  type(error_t), allocatable :: error
  real(dp), allocatable :: x(:, :)
  integer(i8), allocatable :: id(:)
  character(len=256) :: path, word
  integer :: n, changing, frame, m, i

  call get_command_argument(1, path)
  call get_command_argument(2, word)
  read (word, *) n
  call get_command_argument(3, word)
  read (word, *) changing
  call open_output(trim(path), .true., output, error)
  if (.not. allocated(error)) call open_frames(output, "single", frames, error)
  if (.not. allocated(error)) call open_history(output, ["frame", "half "], ["1", "1"], history, error)
  if (.not. allocated(error)) call write_scene(output, "as read", "complete", error)
  call end_if_failed()
  do frame = 1, 1000000
    m = n + changing*mod(7*frame, 5)
    allocate (x(3, m), id(m))
    x = real(frame, dp)
    id = [(int(1000*frame + i, i8), i=1, m)]
    call begin_frame(output, frames, x, error)
    if (.not. allocated(error)) call add_field(output, frames, "velocity", -x, error)
    if (.not. allocated(error)) call add_field(output, frames, "pressure", 0.5_dp*x(1, :), error)
    if (.not. allocated(error)) call add_field(output, frames, "id", id, error)
    if (.not. allocated(error)) call end_frame(output, frames, 0.25_dp*frame, error)
    call end_if_failed()
    do i = 1, 3
      call append_row(output, history, [real(frame, dp), 0.5_dp*frame], error)
      call end_if_failed()
    end do
    call commit_history(output, history, error)
    call end_if_failed()
    write (output_unit, "(i0)") frame
    flush (output_unit)
    deallocate (x, id)
  end do

contains

  subroutine end_if_failed()
    if (.not. allocated(error)) return
    write (error_unit, "(a)") error%message
    stop 3, quiet=.true.
  end subroutine end_if_failed

end program crash_writer
