!> What `gimp.x --help` says, and the input reference; both follow from the tables
module gimp_scene_help
  use gimp_error, only: error_t, raise
  use gimp_text, only: text_of, lower, count_words, nth_word
  use gimp_scene_keys
  use gimp_scene_mistakes, only: suggestion, commas, or_list
  use gimp_scene_values, only: range_words
  implicit none(type, external)
  private
  public :: help_text, group_help, write_reference

  character(len=1), parameter :: nl = new_line("a")

contains

  !> Usage, groups, exit codes
  pure subroutine help_text(text)
    character(len=:), allocatable, intent(out) :: text
    type(group_t), allocatable :: groups(:)
    character(len=:), allocatable :: planned
    integer :: g
    call list_groups(groups)
    text = "gimp.x: the material point method, from one input to one output file"//nl//nl// &
      "usage"//nl// &
      "  gimp.x < scene.nml           run the scene"//nl// &
      "  gimp.x --restart FILE < ...  go on from a checkpoint of the same scene"//nl// &
      "  gimp.x --check < scene.nml   only check it: tells every mistake, or what the run will cost; writes nothing"//nl// &
      "  gimp.x --help [GROUP]        this page; with a group, its keys"//nl// &
      "  gimp.x --reference           all groups and keys as Markdown (docs/input-reference.md)"//nl// &
      "  gimp.x --version             version, commit, kind of build"//nl//nl// &
      "groups of a scene"//nl
    planned = ""
    do g = 1, size(groups)
      if (groups(g)%planned) planned = planned//" &"//trim(groups(g)%name)
      if (groups(g)%planned) cycle
      text = text//"  &"//groups(g)%name//"  "//padded(how_often(groups(g)), 14)//"  "//trim(groups(g)%purpose)//nl
    end do
    text = text//"planned, not built yet: "//commas(planned)//nl//nl// &
      "a scene is namelist text: &group key = value, value key = ""word"" ! comment"//nl// &
      "and a slash at the end of each group; units are SI, angles in degrees only where said"//nl//nl// &
      "exit codes"//nl// &
      "  0  done, also when max_steps ended the run"//nl// &
      "  1  the run failed; the frames written so far stay"//nl// &
      "  2  bad input; nothing was run"//nl// &
      " 75  stopped early, by a signal or max_walltime, with a checkpoint to go on from"
  end subroutine help_text

  !> The keys of a group
  pure subroutine group_help(group, text, error)
    character(len=*), intent(in) :: group !! with or without &
    character(len=:), allocatable, intent(out) :: text
    type(error_t), allocatable, intent(out) :: error !! no such group
    type(group_t), allocatable :: groups(:)
    type(key_t), allocatable :: keys(:)
    character(len=:), allocatable :: name, known
    integer :: g, k
    call list_groups(groups)
    call list_keys(keys)
    name = lower(trim(group))
    if (len(name) > 0) then
      if (name(1:1) == "&") name = name(2:)
    end if
    known = ""
    do g = 1, size(groups)
      known = known//" "//trim(groups(g)%name)
    end do
    do g = 1, size(groups)
      if (groups(g)%name /= name) cycle
      text = "&"//name//" ("//how_often(groups(g))//"): "//trim(groups(g)%purpose)//nl
      do k = 1, size(keys)
        if (keys(k)%group == name) text = text//nl//key_help(keys(k))
      end do
      return
    end do
    text = ""
    call raise(error, "&"//name//": there is no such group; "//suggestion(name, known, "&"))
  end subroutine group_help

  !> A key in the words of the terminal
  pure function key_help(key) result(text)
    type(key_t), intent(in) :: key
    character(len=:), allocatable :: text
    text = "  "//padded(trim(key%name), 21)//" "//kind_words(key)
    if (key%unit /= "") text = text//" ["//trim(key%unit)//"]"
    if (key%range /= "") text = text//", "//range_words(trim(key%range))
    if (key%required .and. key%unless /= "") then
      text = text//", required without "//trim(key%unless)
    else if (key%required) then
      text = text//", required"
    else
      text = text//", default "//default_words(key)
    end if
    text = text//nl//"      "//trim(key%purpose)//nl
    if (key%words /= "") text = text//"      words: "//wrapped(commas(trim(key%words)))//nl
    if (key%planned /= "") text = text//"      planned, not built yet: "//commas(trim(key%planned))//nl
    if (key%when /= "") text = text//"      read with "//condition_words(key%when, "")//nl
    if (key%unless /= "") text = text//"      not together with "//trim(key%unless)//nl
  end function key_help

  !> The whole input reference as Markdown
  subroutine write_reference(unit)
    integer, intent(in) :: unit !! open for formatted writing
    type(group_t), allocatable :: groups(:)
    type(key_t), allocatable :: keys(:)
    integer :: g, k
    call list_groups(groups)
    call list_keys(keys)
    write (unit, "(a)") "# Input reference", "", &
      "Written from the key table of the program (`src/scene/gimp_scene_keys.f90`); do not edit by hand.", "", &
      "A scene is namelist text on standard input: `&group key = value, value key = ""word"" /`. Groups stand in any order;", &
      "an exclamation mark begins a comment. Words and texts need quotes. Units are SI. *d* is the dimension of the scene.", &
      "A key that the choices made do not read is a mistake, as is a misspelt one; all mistakes are told at once."
    do g = 1, size(groups)
      if (groups(g)%planned) cycle
      write (unit, "(a)") "", "## `&"//trim(groups(g)%name)//"`", "", sentence(trim(groups(g)%purpose))//" Stands "// &
        how_often(groups(g))//times(groups(g))//".", "", "| key | values | unit | default | meaning |", &
        "| --- | --- | --- | --- | --- |"
      do k = 1, size(keys)
        if (keys(k)%group == groups(g)%name) write (unit, "(a)") reference_row(keys(k))
      end do
    end do
    write (unit, "(a)") "", "## Planned groups", "", "Known and refused, because they are not built yet:", ""
    do g = 1, size(groups)
      if (groups(g)%planned) write (unit, "(a)") "- `&"//trim(groups(g)%name)//"`: "//trim(groups(g)%purpose)
    end do
  end subroutine write_reference

  !> A key as a row of a Markdown table
  pure function reference_row(key) result(row)
    type(key_t), intent(in) :: key
    character(len=:), allocatable :: row
    row = "| `"//trim(key%name)//"` | "//kind_words(key)
    if (key%range /= "") row = row//", "//range_words(trim(key%range))
    row = row//" | "//trim(key%unit)//" | "
    if (key%required .and. key%unless /= "") then
      row = row//"required without `"//trim(key%unless)//"` | "
    else if (key%required) then
      row = row//"required | "
    else
      row = row//default_words(key)//" | "
    end if
    row = row//sentence(trim(key%purpose))
    if (key%words /= "") row = row//" Words: "//ticked(trim(key%words))//"."
    if (key%planned /= "") row = row//" Planned: "//ticked(trim(key%planned))//"."
    if (key%when /= "") row = row//" Read with "//condition_words(key%when, "`")//"."
    if (key%unless /= "") row = row//" Not together with `"//trim(key%unless)//"`."
    row = row//" |"
  end function reference_row

  pure function how_often(group) result(text)
    type(group_t), intent(in) :: group
    character(len=:), allocatable :: text
    if (group%planned) then
      text = "planned, not built yet"
    else if (group%most == 1) then
      text = "at most once"
      if (group%least == 1) text = "once"
    else
      text = "any number"
      if (group%least == 1) text = "one or more"
    end if
  end function how_often

  !> What makes "any number" and "one or more" the end of a sentence
  pure function times(group) result(text)
    type(group_t), intent(in) :: group
    character(len=:), allocatable :: text
    text = ""
    if (group%planned .or. group%most == 1) return
    text = " of times"
    if (group%least == 1) text = " times"
  end function times

  !> Type and number of values
  pure function kind_words(key) result(text)
    type(key_t), intent(in) :: key
    character(len=:), allocatable :: text
    character(len=*), parameter :: kinds(5) = [character(len=7) :: "real", "integer", "logical", "word", "text"]
    text = trim(kinds(key%kind))
    select case (key%count)
    case (count_axis)
      text = text//", d values"
    case (count_tensor)
      text = text//", d*d values"
    case (count_one_or_axis)
      text = text//", 1 or d values"
    case (count_list)
      text = text//", up to "//text_of(key%most)//" values"
    case (count_points)
      if (key%most < 0) text = text//", d values for each of up to "//text_of(-key%most)
      if (key%most > 0) text = text//", d values for each point, up to "//text_of(key%most)//" in all"
    case (count_rotation)
      text = text//", 1 value in 2D, 3 in 3D"
    end select
    if (key%kind == kind_text) text = text//", up to "//text_of(key%most)//" characters"
  end function kind_words

  !> The default in words
  pure function default_words(key) result(text)
    type(key_t), intent(in) :: key
    character(len=:), allocatable :: text, default, word
    integer :: i, equals
    default = trim(key%default)
    text = "empty"
    if (default == "") return
    text = default
    if (default(1:1) == "(") text = default(2:len(default) - 1)
    if (default(1:1) == "?") then
      text = ""
      do i = 2, count_words(default(2:))
        word = nth_word(default(2:), i)
        equals = index(word, "=")
        if (i > 2) text = text//"; "
        if (nth_word(default(2:), 1) == "dimension") then
          text = text//word(equals + 1:)//" in "//word(:equals - 1)//"D"
        else
          text = text//word(equals + 1:)//pattern_words(word(:equals - 1))
        end if
      end do
    end if
  end function default_words

  !> "linear,*": the words that a default is for, * being any
  pure function pattern_words(pattern) result(text)
    character(len=*), intent(in) :: pattern
    character(len=:), allocatable :: text
    integer :: i, first
    text = ""
    first = 1
    do i = 1, len(pattern) + 1
      if (i <= len(pattern)) then
        if (pattern(i:i) /= ",") cycle
      end if
      if (pattern(first:i - 1) /= "*") then
        if (text /= "") text = text//" with "
        text = text//pattern(first:i - 1)
      end if
      first = i + 1
    end do
    if (text == "") then
      text = " otherwise"
    else
      text = " for "//text
    end if
  end function pattern_words

  !> "key=word|word key=word" in words
  pure function condition_words(conditions, tick) result(text)
    character(len=*), intent(in) :: conditions, tick
    character(len=:), allocatable :: text, condition, words
    integer :: i, k, equals
    text = ""
    do i = 1, count_words(conditions)
      condition = nth_word(conditions, i)
      equals = index(condition, "=")
      words = condition(equals + 1:)
      do k = 1, len(words)
        if (words(k:k) == "|") words(k:k) = " "
      end do
      if (i > 1) text = text//" and with "
      text = text//tick//condition(:equals - 1)//tick//" "//or_list(words)
    end do
  end function condition_words

  pure function ticked(words) result(text)
    character(len=*), intent(in) :: words
    character(len=:), allocatable :: text
    integer :: k
    text = ""
    do k = 1, count_words(words)
      if (k > 1) text = text//", "
      text = text//"`"//nth_word(words, k)//"`"
    end do
  end function ticked

  !> First letter large, a full stop at the end
  pure function sentence(words) result(text)
    character(len=*), intent(in) :: words
    character(len=:), allocatable :: text
    text = words//"."
    if (scan(text(1:1), "abcdefghijklmnopqrstuvwxyz") == 0) return
    if (len(words) > 2) then
      if (words(2:2) == " " .and. words(1:1) /= "a") return ! a symbol, not a word
    end if
    text(1:1) = achar(iachar(text(1:1)) - 32)
  end function sentence

  pure function padded(text, width) result(wide)
    character(len=*), intent(in) :: text
    integer, intent(in) :: width
    character(len=max(width, len(text))) :: wide
    wide = text
  end function padded

  !> A long list over several lines
  pure function wrapped(list) result(text)
    character(len=*), intent(in) :: list
    character(len=:), allocatable :: text
    integer :: i, width
    text = ""
    width = 13
    do i = 1, count_words(list)
      if (width + len(nth_word(list, i)) + 1 > 96) then
        text = text//nl//"             "
        width = 13
      else if (i > 1) then
        text = text//" "
      end if
      text = text//nth_word(list, i)
      width = width + len(nth_word(list, i)) + 1
    end do
  end function wrapped

end module gimp_scene_help
