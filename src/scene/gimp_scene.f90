!> Reading a scene: the text, the checks, and the questions that the program may ask afterwards
module gimp_scene
  use, intrinsic :: iso_fortran_env, only: input_unit
  use gimp_error, only: error_t
  use gimp_scene_keys, only: list_groups, list_keys, text_most
  use gimp_scene_mistakes, only: mistakes_t, note_mistake, tell_mistakes
  use gimp_scene_text, only: line_t, read_lines, split_lines, join_lines, scan_groups, put_text_value
  use gimp_scene_store, only: scene_t, index_blocks, count_groups, is_given, line_of, complain, real_of, reals_of, integer_of, &
                              integers_of, logical_of, word_of, text_of_key, texts_of
  use gimp_scene_rules, only: check_rules
  use gimp_scene_checks, only: check_scene
  use gimp_scene_echo, only: echo_scene
  use gimp_scene_compare, only: scene_differences
  use gimp_scene_help, only: help_text, group_help, write_reference
  implicit none(type, external)
  private
  public :: scene_t, read_input, parse_scene, echo_scene, scene_differences, help_text, group_help, write_reference, text_most
  public :: count_groups, is_given, line_of, complain
  public :: real_of, reals_of, integer_of, integers_of, logical_of, word_of, text_of_key, texts_of

contains

  !> Standard input to its end, once, as one text whose lines each end with a new line
  subroutine read_input(text)
    character(len=:), allocatable, intent(out) :: text
    type(line_t), allocatable :: lines(:)
    call read_lines(input_unit, lines)
    text = join_lines(lines)
  end subroutine read_input

  !> A scene from its text, checked. The error holds all mistakes, one per line.
  subroutine parse_scene(text, scene, error, restart)
    character(len=*), intent(in) :: text
    type(scene_t), intent(out) :: scene
    type(error_t), allocatable, intent(out) :: error
    character(len=*), intent(in), optional :: restart !! checkpoint of the command line, in place of &restart from; empty: none
    type(line_t), allocatable :: lines(:)
    call split_lines(text, lines)
    if (present(restart)) then
      call take_lines(lines, restart, scene, error)
    else
      call take_lines(lines, "", scene, error)
    end if
  end subroutine parse_scene

  subroutine take_lines(lines, restart, scene, error)
    type(line_t), intent(in) :: lines(:)
    character(len=*), intent(in) :: restart
    type(scene_t), intent(inout) :: scene
    type(error_t), allocatable, intent(out) :: error
    type(mistakes_t) :: mistakes
    scene%original = join_lines(lines)
    call list_groups(scene%group)
    call list_keys(scene%key)
    call scan_groups(lines, scene%block, mistakes)
    if (restart /= "") call put_text_value(scene%block, "restart", "from", restart)
    call index_blocks(scene)
    if (size(scene%block) == 0 .and. mistakes%n == 0) then
      call note_mistake(mistakes, 0, "the scene on standard input is empty; gimp.x --help shows what belongs there")
    else
      call check_rules(scene, mistakes)
      call check_scene(scene, mistakes)
    end if
    call tell_mistakes(mistakes, error)
  end subroutine take_lines

end module gimp_scene
