!> Whether a scene is the one that a checkpoint was written by, but for what may change between the two runs
module gimp_scene_compare
  use gimp_text, only: text_of
  implicit none(type, external)
  private
  public :: scene_differences

  integer, parameter :: most_told = 3
  character(len=1), parameter :: nl = new_line("a")

  !> A key of a complete scene
  type :: line_t
    character(len=:), allocatable :: key !! "&body 2: velocity"
    character(len=:), allocatable :: value
    logical :: fixed = .true.
  end type line_t

contains

  !> The first differences between two complete scenes (of `echo_scene`) in words, empty if there are none that matter
  function scene_differences(kept, present) result(words)
    character(len=*), intent(in) :: kept !! of the checkpoint
    character(len=*), intent(in) :: present
    character(len=:), allocatable :: words
    type(line_t), allocatable :: was(:), is(:)
    integer :: i, k, n
    call list_keys(kept, was)
    call list_keys(present, is)
    words = ""
    n = 0
    do i = 1, size(is)
      if (.not. is(i)%fixed) cycle
      k = place_of(was, is(i)%key, i)
      if (k == 0) then
        call tell(is(i)%key//" = "//is(i)%value//" was not there")
      else if (is(i)%value /= was(k)%value) then
        call tell(is(i)%key//" was "//was(k)%value//", is "//is(i)%value)
      end if
    end do
    do i = 1, size(was)
      if (was(i)%fixed .and. place_of(is, was(i)%key, i) == 0) call tell(was(i)%key//" was "//was(i)%value//", is not there")
    end do
    if (n > most_told) words = words//"; and "//text_of(n - most_told)//" more"

  contains

    subroutine tell(what)
      character(len=*), intent(in) :: what
      n = n + 1
      if (n > most_told) return
      if (n > 1) words = words//"; "
      words = words//what
    end subroutine tell

  end function scene_differences

  pure integer function place_of(lines, key, guess) result(place)
    type(line_t), intent(in) :: lines(:)
    character(len=*), intent(in) :: key
    integer, intent(in) :: guess !! where it is if the scenes are alike, as they nearly always are
    integer :: k
    place = 0
    if (guess <= size(lines)) then
      if (lines(guess)%key == key) place = guess
    end if
    if (place > 0) return
    do k = 1, size(lines)
      if (lines(k)%key == key) place = k
    end do
  end function place_of

  !> The keys of a complete scene; a value that goes on in the next line is put together
  pure subroutine list_keys(scene, lines)
    character(len=*), intent(in) :: scene
    type(line_t), allocatable, intent(out) :: lines(:)
    character(len=:), allocatable :: line, group, last
    logical :: uniform
    integer :: first, end, equals, n, which, k
    allocate (lines(count([(scene(k:k) == nl, k=1, len(scene))])))
    n = 0
    which = 0
    first = 1
    group = ""
    last = ""
    do while (first <= len(scene))
      end = index(scene(first:), nl)
      if (end == 0) end = len(scene) - first + 2
      line = scene(first:first + end - 2)
      first = first + end
      equals = index(line, " = ")
      if (index(line, "&") == 1) then
        group = line(2:)
        which = merge(which + 1, 1, group == last)
        last = group
      else if (index(line, "   ") == 1 .and. n > 0) then
        lines(n)%value = lines(n)%value//" "//trim(adjustl(line))
      else if (equals > 3) then
        n = n + 1
        lines(n)%key = "&"//group//" "//text_of(which)//": "//line(3:equals - 1)
        if (which == 1) lines(n)%key = "&"//group//": "//line(3:equals - 1)
        lines(n)%value = line(equals + 3:)
        lines(n)%fixed = .not. may_change(group, line(3:equals - 1))
      end if
    end do
    lines = lines(:n)
    k = place_of(lines, "&time: step_rule", 1)
    uniform = .false.
    if (k > 0) uniform = lines(k)%value == '"uniform"'
    k = place_of(lines, "&time: end", 1)
    if (k > 0) lines(k)%fixed = uniform ! the end of the run divides time into equal steps
  end subroutine list_keys

  !> Keys that steer neither the state nor what is in the output so far
  pure logical function may_change(group, key)
    character(len=*), intent(in) :: group, key
    select case (group)
    case ("restart", "parallel")
      may_change = .true.
    case ("scene")
      may_change = key == "title"
    case ("mesh")
      may_change = key == "file" ! its content is compared
    case ("time")
      may_change = key == "max_steps" ! `end` depends on the rule of steps
    case ("output")
      may_change = any(key == [character(len=13) :: "name", "every", "history_every", "overwrite", "progress"])
    case default
      may_change = .false.
    end select
  end function may_change

end module gimp_scene_compare
