!> The one file a run leaves behind, NAME.vtkhdf: frames, history, scene and summary share it.
!>
!> All ranks have it open and make the same calls: whatever is here and in the modules that write into it is collective. It only
!> grows, and its last commit stays readable after a kill or on a full disk: see `gimp_append_file`.
module gimp_output_file
  use gimp_error, only: error_t
  use gimp_append_file, only: append_file_t, create_append_file, commit_append_file, close_append_file, &
    carry_append_file, reopen_append_file, sync_append_file, set_attribute
  use gimp_parcel, only: parcel_t
  implicit none(type, external)
  private
  public :: output_file_t, open_output, commit_output, close_output, carry_output, sync_output, reopen_output, sign_output

  !> The open output file; frames, history and summary write into it
  type :: output_file_t
    type(append_file_t) :: file
  end type output_file_t

contains

  !> Start an output file. An older file of that name stays until the first commit
  subroutine open_output(path, overwrite, output, error, durable)
    character(len=*), intent(in) :: path !! as in "disks.vtkhdf"
    logical, intent(in) :: overwrite !! else an existing file is an error
    type(output_file_t), intent(out) :: output
    type(error_t), allocatable, intent(out) :: error
    logical, intent(in), optional :: durable !! wait for the device at commits, against crashes of the machine; .false.
    call create_append_file(path, overwrite, output%file, error, durable)
  end subroutine open_output

  !> Make all that was written so far part of the file
  subroutine commit_output(output, error)
    type(output_file_t), intent(inout) :: output
    type(error_t), allocatable, intent(out) :: error
    call commit_append_file(output%file, error)
  end subroutine commit_output

  !> Commit and close; after a failed write the file is left as last committed
  subroutine close_output(output, error)
    type(output_file_t), intent(inout) :: output
    type(error_t), allocatable, intent(out) :: error
    call close_append_file(output%file, error)
  end subroutine close_output

  !> Pack what a later run must know to go on with this file, or unpack it for `reopen_output`
  subroutine carry_output(output, parcel)
    type(output_file_t), intent(inout) :: output
    type(parcel_t), intent(inout) :: parcel
    call carry_append_file(output%file, parcel)
  end subroutine carry_output

  !> Wait until all that was written so far is on the device
  subroutine sync_output(output, error)
    type(output_file_t), intent(inout) :: output
    type(error_t), allocatable, intent(out) :: error
    call sync_append_file(output%file, error)
  end subroutine sync_output

  !> Cut an output file back to the state that was unpacked into `output`, and go on with it
  subroutine reopen_output(path, lineage, output, error)
    character(len=*), intent(in) :: path
    character(len=*), intent(in) :: lineage !! who wrote the file, from now on
    type(output_file_t), intent(inout) :: output
    type(error_t), allocatable, intent(out) :: error
    call reopen_append_file(path, lineage, output%file, error)
  end subroutine reopen_output

  !> Note who writes the file (`longer_lineage`), so that a checkpoint knows it again
  subroutine sign_output(output, lineage, error)
    type(output_file_t), intent(inout) :: output
    character(len=*), intent(in) :: lineage
    type(error_t), allocatable, intent(out) :: error
    call set_attribute(output%file, "", "lineage", lineage, error)
  end subroutine sign_output

end module gimp_output_file
