!> Frames are where the offsets say, and misuse is told
program test_vtkhdf
  use gimp_common_kinds, only: dp, i8
  use gimp_error, only: error_t
  use gimp_file_system, only: delete_file
  use gimp_hdf5, only: hdf5_file_t, open_hdf5, close_hdf5, read_dataset, read_attribute
  use gimp_output_file, only: output_file_t, open_output, close_output, carry_output, reopen_output
  use gimp_parcel, only: parcel_t, pack_parcel, unpack_parcel, is_used_up
  use gimp_vtkhdf, only: frames_t, open_frames, begin_frame, add_field, end_frame, carry_frames
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)
  character(len=*), parameter :: name = "test_frames.vtkhdf"
  integer, parameter :: sizes(6) = [4, 4, 7, 0, 2, 2] !! particles per frame
  type(error_t), allocatable :: error
  integer :: after
  call begin_suite("vtkhdf")
  call frames_come_back("single", interrupted=0)
  call frames_come_back("double", interrupted=0)
  do after = 1, size(sizes)
    call frames_come_back("single", interrupted=after)
  end do
  call misuse()
  call delete_file(name, error)
  call end_suite()

contains

  subroutine write_frames(precision, interrupted)
    character(len=*), intent(in) :: precision
    integer, intent(in) :: interrupted !! after this frame the writer goes on in vain, and another one from there; 0: never
    type(output_file_t) :: output
    type(frames_t) :: frames
    integer :: k
    call open_output(name, .true., output, error)
    call open_frames(output, precision, frames, error)
    call check_true(.not. allocated(error), "open frames")
    do k = 1, size(sizes)
      call write_frame(output, frames, k, sizes(k))
      if (k == interrupted) call go_on_in_vain(output, frames)
    end do
    call check(frames%count, size(sizes), "frames are counted")
    call close_output(output, error)
  end subroutine write_frames

  subroutine write_frame(output, frames, k, n)
    type(output_file_t), intent(inout) :: output
    type(frames_t), intent(inout) :: frames
    integer, intent(in) :: k, n
    real(dp), allocatable :: x(:, :)
    integer :: i
    x = reshape([(k + 0.25_dp*i, i=1, 3*n)], [3, n])
    call begin_frame(output, frames, x, error)
    call add_field(output, frames, "velocity", -x, error)
    call add_field(output, frames, "mass", x(1, :), error)
    call add_field(output, frames, "id", [(int(k*10 + i, i8), i=1, n)], error)
    call end_frame(output, frames, 0.5_dp*k, error)
    call check_true(.not. allocated(error), "write a frame")
  end subroutine write_frame

  subroutine go_on_in_vain(output, frames)
    type(output_file_t), intent(inout) :: output
    type(frames_t), intent(inout) :: frames
    type(parcel_t) :: parcel, packed
    call pack_parcel(packed)
    call carry_frames(frames, packed)
    call carry_output(output, packed)
    call write_frame(output, frames, 77, 3)
    call write_frame(output, frames, 78, 9)
    call close_output(output, error)
    call renew(output, frames)
    call unpack_parcel(parcel, packed%words(:packed%n))
    call carry_frames(frames, parcel)
    call carry_output(output, parcel)
    call check_true(is_used_up(parcel), "the state of frames comes out of its parcel")
    call reopen_output(name, "me", output, error)
    call check_true(.not. allocated(error), "reopen")
  end subroutine go_on_in_vain

  subroutine renew(output, frames)
    type(output_file_t), intent(out) :: output
    type(frames_t), intent(out) :: frames
  end subroutine renew

  subroutine frames_come_back(precision, interrupted)
    character(len=*), intent(in) :: precision
    integer, intent(in) :: interrupted
    type(hdf5_file_t) :: file
    real(dp), allocatable :: points(:, :), mass(:), times(:)
    integer(i8), allocatable :: first(:), part(:), number(:), cells(:, :), offsets(:), connectivity(:), id(:)
    integer(i8) :: steps
    character(len=:), allocatable :: kind
    integer :: k, i, n
    call write_frames(precision, interrupted)
    call open_hdf5(name, "read", file, error)
    call read_attribute(file, "VTKHDF", "Type", kind, error)
    call check(kind, "PolyData", "type of data")
    call read_attribute(file, "VTKHDF/Steps", "NSteps", steps, error)
    call check(int(steps), size(sizes), "number of steps")
    call read_dataset(file, "VTKHDF/Points", points, error)
    call read_dataset(file, "VTKHDF/PointData/mass", mass, error)
    call read_dataset(file, "VTKHDF/PointData/id", id, error)
    call read_dataset(file, "VTKHDF/NumberOfPoints", number, error)
    call read_dataset(file, "VTKHDF/Steps/Values", times, error)
    call read_dataset(file, "VTKHDF/Steps/PointOffsets", first, error)
    call read_dataset(file, "VTKHDF/Steps/PartOffsets", part, error)
    call read_dataset(file, "VTKHDF/Steps/CellOffsets", cells, error)
    call read_dataset(file, "VTKHDF/Vertices/Offsets", offsets, error)
    call read_dataset(file, "VTKHDF/Vertices/Connectivity", connectivity, error)
    call check_true(.not. allocated(error), "all tables are there")
    if (allocated(error)) return
    call check_true(all(connectivity == [(i, i=0, 6)]), "connectivity counts up to the largest frame")
    call check(size(number), 4, "frames of the same size share a part")
    do k = 1, size(sizes)
      n = sizes(k)
      call check(times(k), 0.5_dp*k, 0.0_dp, "time of a frame")
      call check(int(number(part(k) + 1)), n, "points of a frame")
      call check(reshape(points(:, first(k) + 1:first(k) + n), [3*n]), [(k + 0.25_dp*i, i=1, 3*n)], 0.0_dp, "points")
      call check(mass(first(k) + 1:first(k) + n), [(k + 0.25_dp*(3*i - 2), i=1, n)], 0.0_dp, "a field")
      call check_true(all(id(first(k) + 1:first(k) + n) == [(int(k*10 + i, i8), i=1, n)]), "an integer field")
      ! a reader finds the cells of a part at the sum of cells before plus one for each part before
      call check_true(all(offsets(cells(1, k) + part(k) + 1:cells(1, k) + part(k) + n + 1) == [(i, i=0, n)]), "offsets")
    end do
    call close_hdf5(file, error)
  end subroutine frames_come_back

  subroutine misuse()
    type(output_file_t) :: output
    type(frames_t) :: frames
    real(dp) :: x(3, 2)
    x = 1.0_dp
    call open_output(name, .false., output, error)
    call check_true(allocated(error), "an existing file is refused")
    call open_output(name, .true., output, error)
    call open_frames(output, "half", frames, error)
    call check_true(allocated(error), "an unknown precision is refused")
    call open_frames(output, "single", frames, error)
    call add_field(output, frames, "mass", x(1, :), error)
    call check_true(allocated(error), "a field needs a frame")
    call begin_frame(output, frames, x, error)
    call add_field(output, frames, "mass", x(1, :1), error)
    call check_true(allocated(error), "a field has a value per particle")
    call add_field(output, frames, "a/b", x(1, :), error)
    call check_true(allocated(error), "a name without slash")
    call add_field(output, frames, "mass", x(1, :), error)
    call check_true(.not. allocated(error), "a sound field")
    call add_field(output, frames, "mass", x(1, :), error)
    call check_true(allocated(error), "a field only once")
    call end_frame(output, frames, 0.0_dp, error)
    call check_true(.not. allocated(error), "a sound frame")
    call begin_frame(output, frames, x, error)
    call add_field(output, frames, "new", x(1, :), error)
    call check_true(allocated(error), "no new field after the first frame")
    call end_frame(output, frames, 1.0_dp, error)
    call check_true(allocated(error), "a missing field is told")
    if (allocated(error)) call check_true(index(error%message, "mass") > 0, "and named")
    call close_output(output, error)
  end subroutine misuse

end program test_vtkhdf
