!> What a run says about itself: the scene in `/scene`, results and costs as attributes of `/summary`
module gimp_summary
  use gimp_common_kinds, only: dp, i8
  use gimp_error, only: error_t
  use gimp_append_file, only: make_group, put_text, set_attribute
  use gimp_output_file, only: output_file_t
  implicit none(type, external)
  private
  public :: write_scene, put_summary

  !> Set one attribute of `/summary`; one of that name is replaced. It counts from the next commit on
  interface put_summary
    module procedure put_real, put_integer, put_long, put_word
  end interface put_summary

contains

  !> Keep the scene in the output file, so that a run explains itself: texts `input` and `complete`
  subroutine write_scene(output, original, complete, error)
    type(output_file_t), intent(inout) :: output
    character(len=*), intent(in) :: original !! the input as read
    character(len=*), intent(in) :: complete !! with all defaults
    type(error_t), allocatable, intent(out) :: error
    call make_group(output%file, "scene", error)
    if (.not. allocated(error)) call put_text(output%file, "scene/input", original, error)
    if (.not. allocated(error)) call put_text(output%file, "scene/complete", complete, error)
  end subroutine write_scene

  subroutine put_real(output, name, value, error)
    type(output_file_t), intent(inout) :: output
    character(len=*), intent(in) :: name
    real(dp), intent(in) :: value
    type(error_t), allocatable, intent(out) :: error
    call make_group(output%file, "summary", error)
    if (.not. allocated(error)) call set_attribute(output%file, "summary", name, value, error)
  end subroutine put_real

  subroutine put_integer(output, name, value, error)
    type(output_file_t), intent(inout) :: output
    character(len=*), intent(in) :: name
    integer, intent(in) :: value
    type(error_t), allocatable, intent(out) :: error
    call put_long(output, name, int(value, i8), error)
  end subroutine put_integer

  subroutine put_long(output, name, value, error)
    type(output_file_t), intent(inout) :: output
    character(len=*), intent(in) :: name
    integer(i8), intent(in) :: value
    type(error_t), allocatable, intent(out) :: error
    call make_group(output%file, "summary", error)
    if (.not. allocated(error)) call set_attribute(output%file, "summary", name, value, error)
  end subroutine put_long

  subroutine put_word(output, name, value, error)
    type(output_file_t), intent(inout) :: output
    character(len=*), intent(in) :: name, value
    type(error_t), allocatable, intent(out) :: error
    call make_group(output%file, "summary", error)
    if (.not. allocated(error)) call set_attribute(output%file, "summary", name, value, error)
  end subroutine put_word

end module gimp_summary
