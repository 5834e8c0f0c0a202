!> Checks that follow from the key table alone: groups, keys, types, counts, ranges, words, what a choice reads
module gimp_scene_rules
  use gimp_common_kinds, only: dp
  use gimp_text, only: text_of, lower, word_in, count_words, nth_word
  use gimp_scene_keys
  use gimp_scene_mistakes, only: mistakes_t, note_mistake, suggestion, or_list
  use gimp_scene_values, only: parse_real, parse_integer, parse_logical, in_range, range_words, quoted_text
  use gimp_scene_text, only: entry_t, shown_values
  use gimp_scene_store, only: scene_t, count_groups, find_entry, find_key, find_group, is_read, is_given, &
                              note_key, note_group, count_wanted, conditions_hold, chosen, takes_names
  implicit none(type, external)
  private
  public :: check_rules, wanted_words

contains

  !> Note every mistake that the tables show; entries found wrong are marked as not sound. Sets the dimension.
  pure subroutine check_rules(scene, mistakes)
    type(scene_t), intent(inout) :: scene
    type(mistakes_t), intent(inout) :: mistakes
    integer :: b, g, which
    call check_groups(scene, mistakes)
    call find_dimension(scene)
    do b = 1, size(scene%block)
      g = find_group(scene, scene%block(b)%name)
      if (g == 0) cycle
      if (.not. scene%group(g)%planned) call check_block(scene, b, mistakes)
    end do
    do g = 1, size(scene%group)
      if (scene%group(g)%planned) cycle
      do which = 1, count_groups(scene, trim(scene%group(g)%name))
        call check_choices(scene, trim(scene%group(g)%name), which, mistakes)
      end do
    end do
  end subroutine check_rules

  !> Unknown and planned groups, groups too few or too many
  pure subroutine check_groups(scene, mistakes)
    type(scene_t), intent(in) :: scene
    type(mistakes_t), intent(inout) :: mistakes
    character(len=:), allocatable :: known
    integer :: b, g, n, first
    known = ""
    do g = 1, size(scene%group)
      known = known//" "//trim(scene%group(g)%name)
    end do
    do b = 1, size(scene%block)
      g = find_group(scene, scene%block(b)%name)
      if (g == 0) then
        call note_mistake(mistakes, scene%block(b)%line, "&"//scene%block(b)%name//": there is no such group; "// &
                          suggestion(scene%block(b)%name, known, "&"))
      else if (scene%group(g)%planned) then
        call note_mistake(mistakes, scene%block(b)%line, "&"//scene%block(b)%name//": is planned, not built yet")
      end if
    end do
    do g = 1, size(scene%group)
      if (scene%group(g)%planned) cycle
      n = count_groups(scene, trim(scene%group(g)%name))
      if (n < scene%group(g)%least) then
        call note_mistake(mistakes, 0, "&"//trim(scene%group(g)%name)//": the group is missing ("// &
                          trim(scene%group(g)%purpose)//")")
      else if (n > scene%group(g)%most .and. scene%group(g)%most > 0) then
        first = 0
        do b = 1, size(scene%block)
          if (scene%block(b)%name /= scene%group(g)%name) cycle
          if (first > 0) call note_mistake(mistakes, scene%block(b)%line, "&"//scene%block(b)%name// &
                                           ": the group may stand once; it stands already in line "//text_of(first))
          if (first == 0) first = scene%block(b)%line
        end do
      end if
    end do
  end subroutine check_groups

  !> The dimension comes first: it says how many values other keys take
  pure subroutine find_dimension(scene)
    type(scene_t), intent(inout) :: scene
    integer :: b, e, value, status
    scene%dimension = 0
    do b = 1, size(scene%block)
      if (scene%block(b)%name /= "scene") cycle
      e = find_entry(scene, "scene", 1, "dimension")
      if (e == 0) return
      if (scene%block(b)%entry(e)%n /= 1 .or. .not. scene%block(b)%entry(e)%sound) return
      call parse_integer(scene%block(b)%entry(e)%item(1), value, status)
      if (status == 0 .and. value >= 1 .and. value <= 3) scene%dimension = value
      return
    end do
  end subroutine find_dimension

  !> Keys of one group by themselves: known, once, of the right type, number and size
  pure subroutine check_block(scene, b, mistakes)
    type(scene_t), intent(inout) :: scene
    integer, intent(in) :: b
    type(mistakes_t), intent(inout) :: mistakes
    character(len=:), allocatable :: what, name
    integer :: e, f, k
    do e = 1, scene%block(b)%n
      name = scene%block(b)%entry(e)%name
      k = find_key(scene, scene%block(b)%name, name)
      what = ""
      if (k == 0) then
        what = "there is no such key; "//suggestion(name, keys_of(scene, scene%block(b)%name), "")
      else if (scene%block(b)%entry(e)%sound) then
        what = value_fault(scene, scene%key(k), scene%block(b)%entry(e))
      end if
      do f = 1, e - 1
        if (scene%block(b)%entry(f)%name /= name .or. k == 0) cycle
        what = "the key is set already in line "//text_of(scene%block(b)%entry(f)%line)
        exit
      end do
      if (what == "") cycle
      scene%block(b)%entry(e)%sound = .false.
      call note_mistake(mistakes, scene%block(b)%entry(e)%line, "&"//scene%block(b)%name//": "//name//" = "// &
                        shown_values(scene%block(b)%entry(e))//"; "//what)
    end do
  end subroutine check_block

  !> Names of the keys of a group, with a blank between
  pure function keys_of(scene, group) result(names)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group
    character(len=:), allocatable :: names
    integer :: k
    names = ""
    do k = 1, size(scene%key)
      if (scene%key(k)%group == group) names = names//" "//trim(scene%key(k)%name)
    end do
  end function keys_of

  !> What is wrong with the values of a key; empty if nothing is
  pure function value_fault(scene, key, entry) result(what)
    type(scene_t), intent(in) :: scene
    type(key_t), intent(in) :: key
    type(entry_t), intent(in) :: entry
    character(len=:), allocatable :: what
    integer :: i, j
    what = ""
    do i = 1, entry%n
      if (takes_names(scene, key)) then
        what = text_fault(trim(entry%item(i)), entry%length(i), entry%quoted(i), word_most, .false.)
      else
        what = item_fault(key, trim(entry%item(i)), entry%length(i), entry%quoted(i))
      end if
      if (what /= "") return
      if (key%kind /= kind_word) cycle
      do j = 1, i - 1
        if (lower(entry%item(j)) == lower(entry%item(i))) what = quoted_text(trim(entry%item(i)))//" stands twice"
      end do
      if (what /= "") return
    end do
    what = count_fault(scene, key, entry%n)
  end function value_fault

  !> What is wrong with one value
  pure function item_fault(key, item, length, quoted) result(what)
    type(key_t), intent(in) :: key
    character(len=*), intent(in) :: item
    integer, intent(in) :: length !! characters as written
    logical, intent(in) :: quoted
    character(len=:), allocatable :: what
    real(dp) :: number
    integer :: whole, status
    logical :: truth
    what = ""
    status = 0
    select case (key%kind)
    case (kind_real)
      call parse_real(item, number, status)
      if (quoted .or. status == 1) what = quoted_text(item)//" is not a number; "//wanted_words(key)//" is wanted"
      if (.not. quoted .and. status == 2) what = item//" is not a finite number; "//wanted_words(key)//" is wanted"
    case (kind_integer)
      call parse_integer(item, whole, status)
      number = whole
      if (quoted .or. status == 1) what = quoted_text(item)//" is not a whole number; "//wanted_words(key)//" is wanted"
      if (.not. quoted .and. status == 2) what = item//" is too large for a whole number"
    case (kind_logical)
      call parse_logical(item, truth, status)
      if (quoted .or. status /= 0) what = ".true. or .false. is wanted, without quotes"
    case (kind_word)
      what = word_fault(key, item, quoted)
    case (kind_text)
      what = text_fault(item, length, quoted, key%most, key%empty_default)
    end select
    if (what /= "" .or. (key%kind /= kind_real .and. key%kind /= kind_integer)) return
    if (in_range(number, trim(key%range))) return
    what = "must be "//range_words(trim(key%range))
    if (index(range_words(trim(key%range)), "between") == 1) what = "must lie "//range_words(trim(key%range))
    if (key%unit /= "") what = what//" "//trim(key%unit)
  end function item_fault

  !> What is wrong with a text or a name
  pure function text_fault(item, length, quoted, most, may_be_empty) result(what)
    character(len=*), intent(in) :: item
    integer, intent(in) :: length !! characters as written
    logical, intent(in) :: quoted, may_be_empty
    integer, intent(in) :: most !! characters that are taken
    character(len=:), allocatable :: what
    what = ""
    if (.not. quoted) then
      what = quote_advice(item)
    else if (length > most) then
      what = "has "//text_of(length)//" characters; at most "//text_of(most)//" are taken"
    else if (item == "" .and. .not. may_be_empty) then
      what = "must not be empty"
    end if
  end function text_fault

  !> What is wrong with a word
  pure function word_fault(key, item, quoted) result(what)
    type(key_t), intent(in) :: key
    character(len=*), intent(in) :: item
    logical, intent(in) :: quoted
    character(len=:), allocatable :: what
    what = ""
    if (.not. quoted) then
      what = quote_advice(item)
    else if (word_in(lower(item), trim(key%words)) > 0 .and. item /= "") then
      return
    else if (word_in(lower(item), trim(key%planned)) > 0 .and. item /= "") then
      what = quoted_text(item)//" is planned, not built yet; there is "//or_list(trim(key%words))
    else
      what = "there is no such word; "//suggestion(item, trim(key%words)//" "//trim(key%planned), '"')
    end if
  end function word_fault

  pure function quote_advice(item) result(what)
    character(len=*), intent(in) :: item
    character(len=:), allocatable :: what
    what = "words and texts stand in quotes: "//quoted_text(item)
    if (index(item, char(226)) > 0) what = 'words and texts stand in straight quotes: "word"'
  end function quote_advice

  !> What is wrong with the number of values
  pure function count_fault(scene, key, n) result(what)
    type(scene_t), intent(in) :: scene
    type(key_t), intent(in) :: key
    integer, intent(in) :: n
    character(len=:), allocatable :: what
    integer :: wanted, most, d
    what = ""
    d = scene%dimension
    wanted = count_wanted(scene, key)
    select case (key%count)
    case (count_list)
      if (n > key%most) what = "has "//text_of(n)//" values; at most "//text_of(key%most)//" are taken"
    case (count_points)
      if (d == 0) return
      most = key%most
      if (most < 0) most = -most*d
      if (n > most) then
        what = "has "//text_of(n)//" numbers; at most "//text_of(most)//" are taken in "//text_of(d)//"D"
      else if (mod(n, d) /= 0) then
        what = "has "//text_of(n)//" numbers; every point takes "//text_of(d)//" in "//text_of(d)//"D"
      end if
    case (count_rotation)
      ! in 1D no choice reads such a key
      if (d > 1 .and. n /= wanted) what = wrong_count(n, wanted, d)
    case (count_one)
      if (n /= 1) what = "has "//text_of(n)//" values; one is wanted"
    case (count_one_or_axis)
      if (d > 0 .and. n /= 1 .and. n /= wanted) what = "has "//text_of(n)//" values; one for all axes or "//text_of(wanted)// &
        " are wanted in "//text_of(d)//"D"
    case default
      if (d > 0 .and. n /= wanted) what = wrong_count(n, wanted, d)
    end select
  end function count_fault

  pure function wrong_count(n, wanted, d) result(what)
    integer, intent(in) :: n, wanted, d
    character(len=:), allocatable :: what
    character(len=:), allocatable :: values, verb
    values = " values; "
    if (n == 1) values = " value; "
    verb = " are"
    if (wanted == 1) verb = " is"
    what = "has "//text_of(n)//values//text_of(wanted)//verb//" wanted in "//text_of(d)//"D"
  end function wrong_count

  !> A value of a key in words, for messages and help
  pure function wanted_words(key) result(text)
    type(key_t), intent(in) :: key
    character(len=:), allocatable :: text
    select case (key%kind)
    case (kind_word)
      text = or_list(trim(key%words))
      return
    case (kind_text)
      text = "a text in quotes"
      return
    case (kind_logical)
      text = ".true. or .false."
      return
    case (kind_integer)
      text = "a whole number"
    case default
      text = "a number"
    end select
    if (index(range_words(trim(key%range)), "at least") == 1) text = text//" of"
    if (key%range /= "") text = text//" "//range_words(trim(key%range))
    if (key%unit /= "") text = text//" ["//trim(key%unit)//"]"
  end function wanted_words

  !> What the choices of a group read: keys given in vain, keys that are missing, keys that exclude one another
  pure subroutine check_choices(scene, group, which, mistakes)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group
    integer, intent(in) :: which
    type(mistakes_t), intent(inout) :: mistakes
    character(len=:), allocatable :: name
    integer :: k
    do k = 1, size(scene%key)
      if (scene%key(k)%group /= group) cycle
      name = trim(scene%key(k)%name)
      if (is_given(scene, group, which, name)) then
        call check_read(scene, which, k, mistakes)
        if (scene%key(k)%unless == "") cycle
        if (is_given(scene, group, which, trim(scene%key(k)%unless))) &
          call note_key(mistakes, scene, group, which, name, "cannot stand together with "//trim(scene%key(k)%unless)// &
                        "; give one of the two")
      else if (scene%key(k)%required .and. is_read(scene, which, k)) then
        if (scene%key(k)%unless /= "") then
          if (is_given(scene, group, which, trim(scene%key(k)%unless))) cycle
        end if
        if (.not. conditions_hold(scene, group, which, scene%key(k)%needed_when)) cycle
        if (takes_names(scene, scene%key(k))) then
          call note_group(mistakes, scene, group, which, name//" is not set; a name in quotes is wanted")
        else
          call note_group(mistakes, scene, group, which, name//" is not set; "//wanted_words(scene%key(k))//" is wanted")
        end if
      end if
    end do
  end subroutine check_choices

  !> A key that is written though the first choice that matters does not read it
  pure subroutine check_read(scene, which, k, mistakes)
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: which
    integer, intent(in) :: k !! row of the key table
    type(mistakes_t), intent(inout) :: mistakes
    character(len=:), allocatable :: group, condition, choice, steering, readers
    integer :: i, equals
    group = trim(scene%key(k)%group)
    do i = 1, count_words(scene%key(k)%when)
      condition = nth_word(scene%key(k)%when, i)
      if (conditions_hold(scene, group, which, condition)) cycle
      equals = index(condition, "=")
      steering = condition(:equals - 1)
      choice = chosen(scene, group, which, steering)
      if (choice == "") return ! missing or mistaken: told elsewhere
      readers = condition(equals + 1:)
      do while (index(readers, "|") > 0)
        readers(index(readers, "|"):index(readers, "|")) = " "
      end do
      call note_key(mistakes, scene, group, which, trim(scene%key(k)%name), "is not read by "//steering//" "//choice// &
                    ", only by "//or_list(readers))
      return
    end do
  end subroutine check_read

end module gimp_scene_rules
