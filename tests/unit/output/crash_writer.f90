!> Writes frames and history rows, for tests that kill it or compare its files: after each commit it prints how many frames are safe.
!> Arguments: output path, particles, 1 if their number changes from frame to frame, and perhaps the number of frames; without it
!> they have no end. After half of the frames it goes on in vain for two, and then from there again. Values follow from the number of the frame.
program crash_writer
  use, intrinsic :: iso_fortran_env, only: output_unit, error_unit
  use gimp_common_kinds, only: dp, i8
  use gimp_error, only: error_t
  use gimp_parcel, only: parcel_t, pack_parcel, unpack_parcel
  use gimp_ranks, only: this_rank, start_ranks, end_ranks
  use gimp_slabs, only: slab_t, slab_of
  use gimp_output_file, only: output_file_t, open_output, close_output, carry_output, reopen_output
  use gimp_vtkhdf, only: frames_t, open_frames, begin_frame, add_field, end_frame, carry_frames
  use gimp_history, only: history_t, open_history, append_row, commit_history, close_history, carry_history, reopen_csv
  use gimp_summary, only: write_scene, put_summary
  implicit none(type, external)
  type(output_file_t) :: output
  type(frames_t) :: frames
  type(history_t) :: history
  type(error_t), allocatable :: error
  character(len=256) :: path, word
  integer :: n, changing, frame, last

  call start_ranks()
  call get_command_argument(1, path)
  call get_command_argument(2, word)
  read (word, *) n
  call get_command_argument(3, word)
  read (word, *) changing
  last = 0
  call get_command_argument(4, word)
  if (word /= "") read (word, *) last
  call open_output(trim(path), .true., output, error)
  if (.not. allocated(error)) call open_frames(output, "single", frames, error)
  if (.not. allocated(error)) call open_history(output, ["frame", "half "], ["1", "1"], history, error, csv=trim(path)//".csv")
  if (.not. allocated(error)) call write_scene(output, "as read", "complete", error)
  call end_if_failed()
  do frame = 1, merge(last, 1000000, last > 0)
    call write_frame(frame)
    if (2*frame == last) call go_on_in_vain()
    if (this_rank > 0) cycle
    write (output_unit, "(i0)") frame
    flush (output_unit)
  end do
  call put_summary(output, "status", "done", error)
  call end_if_failed()
  call close_history(output, history, error)
  call end_if_failed()
  call close_output(output, error)
  call end_if_failed()
  call end_ranks(0)

contains

  subroutine write_frame(frame)
    integer, intent(in) :: frame
    type(slab_t) :: slab
    real(dp), allocatable :: x(:, :)
    integer(i8) :: i
    integer :: k
    slab = slab_of(n + changing*mod(7_i8*frame, 5_i8))
    allocate (x(3, slab%mine), source=real(frame, dp))
    call begin_frame(output, frames, x, error, slab%before, slab%n)
    if (.not. allocated(error)) call add_field(output, frames, "velocity", -x, error)
    if (.not. allocated(error)) call add_field(output, frames, "pressure", [(0.5_dp*frame + slab%before + i, i=1, slab%mine)], error)
    if (.not. allocated(error)) call add_field(output, frames, "id", [(1000*frame + slab%before + i, i=1, slab%mine)], error)
    if (.not. allocated(error)) call end_frame(output, frames, 0.25_dp*frame, error)
    call end_if_failed()
    do k = 1, 3
      call append_row(output, history, [real(frame, dp), 0.5_dp*frame], error)
      call end_if_failed()
    end do
    call commit_history(output, history, error)
    call end_if_failed()
  end subroutine write_frame

  subroutine go_on_in_vain()
    type(parcel_t) :: packed, parcel
    call pack_parcel(packed)
    call carry_frames(frames, packed)
    call carry_history(history, packed)
    call carry_output(output, packed)
    call write_frame(77)
    call write_frame(78)
    call close_history(output, history, error)
    call close_output(output, error)
    call end_if_failed()
    call renew(output, frames, history)
    call unpack_parcel(parcel, packed%words(:packed%n))
    call carry_frames(frames, parcel)
    call carry_history(history, parcel)
    call carry_output(output, parcel)
    call reopen_output(trim(path), "me", output, error)
    call end_if_failed()
    call reopen_csv(history, trim(path)//".csv", error)
    call end_if_failed()
  end subroutine go_on_in_vain

  subroutine renew(output, frames, history)
    type(output_file_t), intent(out) :: output
    type(frames_t), intent(out) :: frames
    type(history_t), intent(out) :: history
  end subroutine renew

  subroutine end_if_failed()
    if (.not. allocated(error)) return
    if (this_rank == 0) write (error_unit, "(a)") error%message
    call end_ranks(3)
  end subroutine end_if_failed

end program crash_writer
