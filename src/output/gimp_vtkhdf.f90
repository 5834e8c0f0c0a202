!> Particles over time as one temporal VTKHDF PolyData (format version 2.0; VTK 9.3, ParaView 5.12 and newer open it as it is).
!>
!> Every frame is committed whole by `end_frame`; until then readers see the frames before it. Points and fields of all frames
!> stand one after another and `Steps/PointOffsets` says where a frame begins. Each particle is a vertex cell, so that filters
!> which work on cells (threshold) apply. What these cells need, 0, 1, 2, ..., is the same in every frame: frames with the same
!> number of particles share it, and it costs nothing after the first frame.
!>
!> Each rank gives a slab of the points and the same slab of every field.
module gimp_vtkhdf
  use gimp_common_kinds, only: dp, i8
  use gimp_error, only: error_t, raise
  use gimp_text, only: text_of
  use gimp_parcel, only: parcel_t, carry_bits
  use gimp_append_file, only: make_group, make_table, append_rows, append_slab, table_rows, set_attribute, stored_real32, stored_real64, &
    stored_int64
  use gimp_output_file, only: output_file_t, commit_output
  use gimp_ranks, only: ranks
  use gimp_slabs, only: slab_t, slab_of
  implicit none(type, external)
  private
  public :: frames_t, open_frames, begin_frame, add_field, end_frame, carry_frames

  integer, parameter :: max_fields = 64
  integer(i8), parameter :: fewest_rows = 1024, most_rows = 2_i8**20 !! particles stored together
  integer(i8), parameter :: steps_chunk = 64 !! frames stored together in tables with an entry per frame
  character(len=*), parameter :: topology(4) = [character(len=8) :: "Vertices", "Lines", "Polygons", "Strips"]

  !> Tables of one of the four kinds of cells
  type :: cells_t
    integer :: cells = 0, ids = 0, connectivity = 0, offsets = 0
  end type cells_t

  !> The frames of a run and where they stand in the file
  type :: frames_t
    integer :: count = 0 !! committed frames
    integer :: fields = 0
    character(len=32) :: field_name(max_fields) = ""
    integer, private :: field_table(max_fields) = 0
    integer, private :: stored = stored_real32
    integer, private :: points = 0, number_of_points = 0
    integer, private :: values = 0, part_offsets = 0, number_of_parts = 0, point_offsets = 0, cell_offsets = 0, id_offsets = 0
    type(cells_t), private :: kind(4)
    logical, private :: in_frame = .false.
    integer(i8), private :: n = -1 ! particles of the frame under way, or of the last one
    integer(i8), private :: first = 0 ! row of Points where it begins
    integer(i8), private :: first_cell = 0 ! where its cells begin
    integer(i8), private :: parts = 0
    integer(i8), private :: before = 0, mine = 0 ! particles of the frame under way in the slabs of ranks before, and in this one
  end type frames_t

  !> Give the particles of the frame under way a named quantity, in the order of the points.
  !> Every frame has the same fields; the first frame says which.
  interface add_field
    module procedure add_vectors, add_scalars, add_integers
  end interface add_field

contains

  !> Prepare the output file for frames
  subroutine open_frames(output, precision, frames, error)
    type(output_file_t), intent(inout) :: output
    character(len=*), intent(in) :: precision !! "single" or "double", of points and fields
    type(frames_t), intent(out) :: frames
    type(error_t), allocatable, intent(out) :: error
    if (precision /= "single" .and. precision /= "double") then
      call raise(error, "precision of frames is "//precision//"; must be single or double")
      return
    end if
    frames%stored = merge(stored_real64, stored_real32, precision == "double")
    call make_group(output%file, "VTKHDF", error)
    if (.not. allocated(error)) call set_attribute(output%file, "VTKHDF", "Version", [2_i8, 0_i8], error)
    if (.not. allocated(error)) call set_attribute(output%file, "VTKHDF", "Type", "PolyData", error)
    if (.not. allocated(error)) call make_group(output%file, "VTKHDF/PointData", error)
    if (.not. allocated(error)) call make_group(output%file, "VTKHDF/Steps", error)
    if (.not. allocated(error)) call set_attribute(output%file, "VTKHDF/Steps", "NSteps", 0, error)
    if (allocated(error)) return
    call make_step_table("Values", stored_real64, 1, frames%values)
    call make_step_table("PartOffsets", stored_int64, 1, frames%part_offsets)
    call make_step_table("NumberOfParts", stored_int64, 1, frames%number_of_parts)
    call make_step_table("PointOffsets", stored_int64, 1, frames%point_offsets)
    call make_step_table("CellOffsets", stored_int64, 4, frames%cell_offsets)
    call make_step_table("ConnectivityIdOffsets", stored_int64, 4, frames%id_offsets)
  contains
    subroutine make_step_table(name, stored, components, table)
      character(len=*), intent(in) :: name
      integer, intent(in) :: stored, components
      integer, intent(inout) :: table
      if (allocated(error)) return
      call make_table(output%file, "VTKHDF/Steps/"//name, stored, components, steps_chunk, table, error)
    end subroutine make_step_table
  end subroutine open_frames

  !> The tables whose chunks suit the number of particles, made when the first frame tells it
  subroutine make_point_tables(output, frames, n, error)
    type(output_file_t), intent(inout) :: output
    type(frames_t), intent(inout) :: frames
    integer(i8), intent(in) :: n
    type(error_t), allocatable, intent(out) :: error
    integer :: k
    call make_table(output%file, "VTKHDF/Points", frames%stored, 3, chunk_for(n), frames%points, error)
    call make_one("NumberOfPoints", steps_chunk, frames%number_of_points)
    do k = 1, 4
      if (.not. allocated(error)) call make_group(output%file, "VTKHDF/"//trim(topology(k)), error)
      call make_one(trim(topology(k))//"/NumberOfCells", steps_chunk, frames%kind(k)%cells)
      call make_one(trim(topology(k))//"/NumberOfConnectivityIds", steps_chunk, frames%kind(k)%ids)
      call make_one(trim(topology(k))//"/Connectivity", merge(chunk_for(n), steps_chunk, k == 1), frames%kind(k)%connectivity)
      call make_one(trim(topology(k))//"/Offsets", merge(chunk_for(n), steps_chunk, k == 1), frames%kind(k)%offsets)
    end do
  contains
    subroutine make_one(name, rows, table)
      character(len=*), intent(in) :: name
      integer(i8), intent(in) :: rows
      integer, intent(inout) :: table
      if (allocated(error)) return
      call make_table(output%file, "VTKHDF/"//name, stored_int64, 1, rows, table, error)
    end subroutine make_one
  end subroutine make_point_tables

  pure integer(i8) function chunk_for(n)
    integer(i8), intent(in) :: n
    chunk_for = min(most_rows, max(fewest_rows, n))
  end function chunk_for

  !> A frame without particles gets one cell without points: VTK 9.3 and 9.7 disagree on where the cells begin that follow a
  !> part without any (9.3 counts one more entry in Offsets for it, 9.7 does not)
  pure integer(i8) function cells_of(n)
    integer(i8), intent(in) :: n !! particles
    cells_of = max(1_i8, n)
  end function cells_of

  !> Start a frame with its points; their number may differ from frame to frame
  subroutine begin_frame(output, frames, x, error, before, of)
    type(output_file_t), intent(inout) :: output
    type(frames_t), intent(inout) :: frames
    real(dp), intent(in), contiguous :: x(:, :) !! (3, particles of this rank's slab) [m]; z = 0 in two dimensions
    type(error_t), allocatable, intent(out) :: error
    integer(i8), intent(in), optional :: before !! particles in the slabs of the ranks before; 0 if absent
    integer(i8), intent(in), optional :: of !! particles of all ranks; if absent this rank has them all
    integer(i8) :: n_before
    if (frames%in_frame) then
      call raise(error, "a frame was begun before the last one was ended")
      return
    end if
    frames%mine = size(x, 2, kind=i8)
    frames%before = 0
    if (present(before)) frames%before = before
    n_before = frames%n
    frames%n = frames%mine
    if (present(of)) frames%n = of
    if (frames%points == 0) call make_point_tables(output, frames, frames%n, error)
    if (allocated(error)) return
    frames%in_frame = .true.
    frames%first = table_rows(output%file, frames%points)
    call append_slab(output%file, frames%points, x, frames%before, frames%n, error)
    if (.not. allocated(error) .and. frames%n /= n_before) call add_part(output, frames, n_before, error)
  end subroutine begin_frame

  !> Cells for a number of particles that the frame before did not have
  subroutine add_part(output, frames, before, error)
    type(output_file_t), intent(inout) :: output
    type(frames_t), intent(inout) :: frames
    integer(i8), intent(in) :: before !! particles of the frame before, -1 for none
    type(error_t), allocatable, intent(out) :: error
    integer :: k
    if (before >= 0) frames%first_cell = frames%first_cell + cells_of(before)
    frames%parts = frames%parts + 1
    call append_rows(output%file, frames%number_of_points, [frames%n], error)
    do k = 1, 4
      call append_one(frames%kind(k)%cells, merge(cells_of(frames%n), 0_i8, k == 1))
      call append_one(frames%kind(k)%ids, merge(frames%n, 0_i8, k == 1))
      if (k > 1) call append_one(frames%kind(k)%offsets, 0_i8)
    end do
    ! connectivity 0, 1, 2, ... serves every number of particles up to its length
    call count_up(frames%kind(1)%connectivity, table_rows(output%file, frames%kind(1)%connectivity), frames%n - 1)
    call count_up(frames%kind(1)%offsets, 0_i8, frames%n)
    if (frames%n == 0) call append_one(frames%kind(1)%offsets, 0_i8) ! the end of the one cell without points
  contains
    subroutine append_one(table, value)
      integer, intent(in) :: table
      integer(i8), intent(in) :: value
      if (allocated(error)) return
      call append_rows(output%file, table, [value], error)
    end subroutine append_one

    subroutine count_up(table, from, to)
      integer, intent(in) :: table
      integer(i8), intent(in) :: from, to
      integer(i8), parameter :: at_once = 65536 ! of each rank
      type(slab_t) :: slab
      integer(i8) :: i, next
      next = from
      do while (next <= to .and. .not. allocated(error))
        slab = slab_of(min(to - next + 1, ranks*at_once))
        call append_slab(output%file, table, [(next + slab%before + i, i=0, slab%mine - 1)], slab%before, slab%n, error)
        next = next + slab%n
      end do
    end subroutine count_up
  end subroutine add_part

  subroutine add_vectors(output, frames, name, values, error)
    type(output_file_t), intent(inout) :: output
    type(frames_t), intent(inout) :: frames
    character(len=*), intent(in) :: name
    real(dp), intent(in), contiguous :: values(:, :) !! (components, particles of the slab)
    type(error_t), allocatable, intent(out) :: error
    integer :: table
    call find_field(output, frames, name, frames%stored, size(values, 1), size(values, 2, kind=i8), table, error)
    if (.not. allocated(error)) call append_slab(output%file, table, values, frames%before, frames%n, error)
  end subroutine add_vectors

  subroutine add_scalars(output, frames, name, values, error)
    type(output_file_t), intent(inout) :: output
    type(frames_t), intent(inout) :: frames
    character(len=*), intent(in) :: name
    real(dp), intent(in), contiguous :: values(:) !! (particles of the slab)
    type(error_t), allocatable, intent(out) :: error
    integer :: table
    call find_field(output, frames, name, frames%stored, 1, size(values, kind=i8), table, error)
    if (.not. allocated(error)) call append_slab(output%file, table, values, frames%before, frames%n, error)
  end subroutine add_scalars

  subroutine add_integers(output, frames, name, values, error)
    type(output_file_t), intent(inout) :: output
    type(frames_t), intent(inout) :: frames
    character(len=*), intent(in) :: name
    integer(i8), intent(in), contiguous :: values(:) !! (particles of the slab)
    type(error_t), allocatable, intent(out) :: error
    integer :: table
    call find_field(output, frames, name, stored_int64, 1, size(values, kind=i8), table, error)
    if (.not. allocated(error)) call append_slab(output%file, table, values, frames%before, frames%n, error)
  end subroutine add_integers

  !> The table of a field, made in the first frame, checked in all
  subroutine find_field(output, frames, name, stored, components, n, table, error)
    type(output_file_t), intent(inout) :: output
    type(frames_t), intent(inout) :: frames
    character(len=*), intent(in) :: name
    integer, intent(in) :: stored, components
    integer(i8), intent(in) :: n
    integer, intent(out) :: table
    type(error_t), allocatable, intent(out) :: error
    integer :: k
    table = 0
    if (.not. frames%in_frame) then
      call raise(error, "field "//name//" was given outside a frame")
    else if (n /= frames%mine) then
      call raise(error, "field "//name//" has "//text_of(n)//" values for "//text_of(frames%mine)//" particles")
    else if (scan(name, "/.") > 0 .or. len(name) > len(frames%field_name) .or. len(name) == 0) then
      call raise(error, "field "//name//": a name has 1 to 32 characters, neither / nor .")
    end if
    if (allocated(error)) return
    do k = 1, frames%fields
      if (frames%field_name(k) == name) exit
    end do
    if (k <= frames%fields) then
      table = frames%field_table(k)
      if (table_rows(output%file, table) /= frames%first) call raise(error, "field "//name//" was given twice in a frame")
      return
    end if
    if (frames%count > 0 .or. k > max_fields) then
      call raise(error, "field "//name//" is new; the first frame must have all fields, at most "//text_of(max_fields))
      return
    end if
    call make_table(output%file, "VTKHDF/PointData/"//name, stored, components, chunk_for(frames%n), table, error)
    if (allocated(error)) return
    frames%fields = k
    frames%field_name(k) = name
    frames%field_table(k) = table
  end subroutine find_field

  !> Finish the frame under way and commit it
  subroutine end_frame(output, frames, time, error)
    type(output_file_t), intent(inout) :: output
    type(frames_t), intent(inout) :: frames
    real(dp), intent(in) :: time !! [s]
    type(error_t), allocatable, intent(out) :: error
    integer(i8) :: cell(4, 1), ids(4, 1)
    integer :: k
    if (.not. frames%in_frame) then
      call raise(error, "a frame was ended that was not begun")
      return
    end if
    do k = 1, frames%fields
      if (table_rows(output%file, frames%field_table(k)) == frames%first + frames%n) cycle
      call raise(error, "field "//trim(frames%field_name(k))//" is missing in frame "//text_of(frames%count + 1))
      return
    end do
    ids = 0
    cell = 0
    cell(1, 1) = frames%first_cell
    call append_rows(output%file, frames%values, [time], error)
    call append_one(frames%part_offsets, frames%parts - 1)
    call append_one(frames%number_of_parts, 1_i8)
    call append_one(frames%point_offsets, frames%first)
    if (.not. allocated(error)) call append_rows(output%file, frames%cell_offsets, cell, error)
    if (.not. allocated(error)) call append_rows(output%file, frames%id_offsets, ids, error)
    if (.not. allocated(error)) call set_attribute(output%file, "VTKHDF/Steps", "NSteps", frames%count + 1, error)
    if (.not. allocated(error)) call commit_output(output, error)
    if (allocated(error)) return
    frames%count = frames%count + 1
    frames%in_frame = .false.
    frames%before = 0 ! what is kept of frames does not tell how many ranks there were
    frames%mine = 0
  contains
    subroutine append_one(table, value)
      integer, intent(in) :: table
      integer(i8), intent(in) :: value
      if (allocated(error)) return
      call append_rows(output%file, table, [value], error)
    end subroutine append_one
  end subroutine end_frame

  !> Pack or unpack what is known of the frames of a file between two frames
  pure subroutine carry_frames(frames, parcel)
    type(frames_t), intent(inout) :: frames
    type(parcel_t), intent(inout) :: parcel
    integer(i8) :: words(storage_size(frames)/64)
    words = transfer(frames, words)
    call carry_bits(parcel, words)
    if (parcel%reading) frames = transfer(words, frames)
  end subroutine carry_frames

end module gimp_vtkhdf
