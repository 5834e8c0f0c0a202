!> The complete scene: what was written and every default that holds, as namelist text that can be run again
module gimp_scene_echo
  use gimp_common_kinds, only: dp
  use gimp_text, only: text_of
  use gimp_scene_keys
  use gimp_scene_values, only: exact_text, quoted_text
  use gimp_scene_store, only: scene_t, count_groups, is_given, is_read, has_value, reals_of, integers_of, logical_of, &
                              text_of_key, texts_of
  implicit none(type, external)
  private
  public :: echo_scene

  integer, parameter :: columns = 96 !! a longer list goes on in the next line

contains

  !> Groups in the order of the table, groups of one kind in the order of the scene. Reading the text gives the same scene,
  !> to the last bit of every number.
  pure subroutine echo_scene(scene, text)
    type(scene_t), intent(in) :: scene !! read without a mistake
    character(len=:), allocatable, intent(out) :: text
    character(len=:), allocatable :: part
    integer :: g, which, n
    text = ""
    do g = 1, size(scene%group)
      if (scene%group(g)%planned) cycle
      n = count_groups(scene, trim(scene%group(g)%name))
      if (n == 0 .and. all_default(scene, scene%group(g))) n = 1
      do which = 1, n
        call echo_group(scene, trim(scene%group(g)%name), which, part)
        text = text//part
      end do
    end do
  end subroutine echo_scene

  !> Whether an absent group still says something: it stands once and nothing in it is required
  pure logical function all_default(scene, group)
    type(scene_t), intent(in) :: scene
    type(group_t), intent(in) :: group
    all_default = group%most == 1 .and. .not. any(scene%key%group == group%name .and. scene%key%required)
  end function all_default

  pure subroutine echo_group(scene, group, which, text)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group
    integer, intent(in) :: which
    character(len=:), allocatable, intent(out) :: text
    character(len=:), allocatable :: name
    integer :: k
    text = "&"//group//new_line("a")
    do k = 1, size(scene%key)
      if (scene%key(k)%group /= group) cycle
      name = trim(scene%key(k)%name)
      if (.not. (is_read(scene, which, k) .and. has_value(scene, group, which, name))) cycle
      if (scene%key(k)%unless /= "") then
        if (is_given(scene, group, which, trim(scene%key(k)%unless))) cycle
      end if
      text = text//"  "//name//" = "//values_text(scene, group, which, scene%key(k))
      if (scene%key(k)%unit /= "") text = text//" ! "//trim(scene%key(k)%unit)
      text = text//new_line("a")
    end do
    text = text//"/"//new_line("a")
  end subroutine echo_group

  !> The values of a key, in lines of a readable length
  pure function values_text(scene, group, which, key) result(text)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group
    integer, intent(in) :: which
    type(key_t), intent(in) :: key
    character(len=:), allocatable :: text, name
    character(len=64), allocatable :: words(:)
    real(dp), allocatable :: numbers(:)
    integer, allocatable :: wholes(:)
    integer :: i, width
    name = trim(key%name)
    text = ""
    width = len(name) + 5
    select case (key%kind)
    case (kind_real)
      allocate (numbers, source=reals_of(scene, group, which, name))
      do i = 1, size(numbers)
        call append_item(text, width, exact_text(numbers(i)))
      end do
    case (kind_integer)
      allocate (wholes, source=integers_of(scene, group, which, name))
      do i = 1, size(wholes)
        call append_item(text, width, text_of(wholes(i)))
      end do
    case (kind_logical)
      text = text_of(logical_of(scene, group, which, name))
    case (kind_word)
      allocate (words, source=texts_of(scene, group, which, name))
      do i = 1, size(words)
        call append_item(text, width, quoted_text(trim(words(i))))
      end do
    case default
      text = quoted_text(text_of_key(scene, group, which, name))
    end select
  end function values_text

  !> Add a value to a list with commas; `width` is the length of the line so far
  pure subroutine append_item(text, width, item)
    character(len=:), allocatable, intent(inout) :: text
    integer, intent(inout) :: width
    character(len=*), intent(in) :: item
    if (text /= "") then
      text = text//","
      if (width + len(item) + 2 > columns) then
        text = text//new_line("a")//"   "
        width = 3
      end if
      text = text//" "
    end if
    text = text//item
    width = width + len(item) + 2
  end subroutine append_item

end module gimp_scene_echo
