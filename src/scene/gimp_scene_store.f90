!> A scene in memory and the ways to ask it: what was written, or else the default of the key table.
!>
!> A group and key that the table does not know, or a key asked for as the wrong type, is a mistake of the program, not of
!> the scene, and stops at once. Groups are counted in the order of the scene: the second &body is `which = 2`. A group that
!> is absent gives its defaults (`which = 1`).
module gimp_scene_store
  use gimp_common_kinds, only: dp
  use gimp_error, only: error_t, add_error
  use gimp_text, only: lower, text_of, count_words, nth_word
  use gimp_scene_keys
  use gimp_scene_mistakes, only: mistakes_t, note_mistake
  use gimp_scene_values, only: parse_real, parse_integer, parse_logical, count_values, nth_value
  use gimp_scene_text, only: block_t, shown_values
  implicit none(type, external)
  private
  public :: scene_t, count_groups, is_given, line_of, complain, note_key, note_group
  public :: real_of, reals_of, integer_of, integers_of, logical_of, word_of, text_of_key, texts_of
  public :: index_blocks, find_block, find_entry, find_key, find_group, is_read, has_value, usable, takes_names, count_wanted, default_of, conditions_hold, chosen

  !> All that the author of a scene wrote
  type :: scene_t
    character(len=:), allocatable :: original !! the text as read
    integer :: dimension = 0 !! 1 to 3; 0 while unknown
    type(block_t), allocatable :: block(:) !! groups in the order of the scene
    integer, allocatable :: place(:, :) !! (which, row of the group table): position in block, 0 if there is none
    type(key_t), allocatable :: key(:) !! the key table
    type(group_t), allocatable :: group(:) !! the group table
  end type scene_t

contains

  !> Note where the groups of each kind are, once all are there: scenes may hold thousands
  pure subroutine index_blocks(scene)
    type(scene_t), intent(inout) :: scene
    integer :: row(size(scene%block)), found(size(scene%group)), b
    do b = 1, size(scene%block)
      row(b) = find_group(scene, scene%block(b)%name)
    end do
    found = [(count(row == b), b=1, size(scene%group))]
    allocate (scene%place(maxval(found), size(scene%group)), source=0)
    found = 0
    do b = 1, size(scene%block)
      if (row(b) == 0) cycle
      found(row(b)) = found(row(b)) + 1
      scene%place(found(row(b)), row(b)) = b
    end do
  end subroutine index_blocks

  !> How many groups of that name the scene holds
  pure integer function count_groups(scene, group)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group
    count_groups = count(scene%place(:, known_group(scene, group)) > 0)
  end function count_groups

  !> Position in `scene%block` of the which-th group of that name; 0 if there is none
  pure integer function find_block(scene, group, which)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group
    integer, intent(in) :: which
    integer :: g
    find_block = 0
    g = known_group(scene, group)
    if (which >= 1 .and. which <= size(scene%place, 1)) find_block = scene%place(which, g)
  end function find_block

  !> Position of a key in its block; 0 if it is not written. The first one counts if it is written twice.
  pure integer function find_entry(scene, group, which, key)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, key
    integer, intent(in) :: which
    integer :: b, e
    find_entry = 0
    b = find_block(scene, group, which)
    if (b == 0) return
    do e = 1, scene%block(b)%n
      if (scene%block(b)%entry(e)%name /= key) cycle
      find_entry = e
      return
    end do
  end function find_entry

  !> Row of a key in the key table; 0 if it is unknown
  pure integer function find_key(scene, group, key)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, key
    integer :: k
    find_key = 0
    do k = 1, size(scene%key)
      if (scene%key(k)%group == group .and. scene%key(k)%name == key) find_key = k
    end do
  end function find_key

  !> Row of a group in the group table; 0 if it is unknown
  pure integer function find_group(scene, group)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group
    integer :: g
    find_group = 0
    do g = 1, size(scene%group)
      if (scene%group(g)%name == group) find_group = g
    end do
  end function find_group

  !> Whether the key is written in the scene
  pure logical function is_given(scene, group, which, key)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, key
    integer, intent(in) :: which
    integer :: k
    k = known_key(scene, group, key)
    is_given = find_entry(scene, group, which, key) > 0
  end function is_given

  !> Line of the key in the scene, else of its group, else 0
  pure integer function line_of(scene, group, which, key)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, key
    integer, intent(in) :: which
    integer :: b, e
    line_of = 0
    b = find_block(scene, group, which)
    if (b == 0) return
    line_of = scene%block(b)%line
    e = find_entry(scene, group, which, key)
    if (e > 0) line_of = scene%block(b)%entry(e)%line
  end function line_of

  !> A number, in the unit of the key table; 0 if it is neither written nor has a default
  pure real(dp) function real_of(scene, group, which, key)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, key
    integer, intent(in) :: which
    real(dp), allocatable :: values(:)
    allocate (values, source=reals_of(scene, group, which, key))
    real_of = 0.0_dp
    if (size(values) > 0) real_of = values(1)
  end function real_of

  !> All numbers of a key; a default of one number stands for as many as the key takes; empty if there are none
  pure function reals_of(scene, group, which, key) result(values)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, key
    integer, intent(in) :: which
    real(dp), allocatable :: values(:)
    character(len=256), allocatable :: items(:)
    integer :: k, status
    call items_of(scene, group, which, key, [kind_real, kind_integer], items)
    allocate (values(size(items)))
    do k = 1, size(items)
      call parse_real(items(k), values(k), status)
    end do
  end function reals_of

  !> A whole number; 0 if it is neither written nor has a default
  pure integer function integer_of(scene, group, which, key)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, key
    integer, intent(in) :: which
    integer, allocatable :: values(:)
    allocate (values, source=integers_of(scene, group, which, key))
    integer_of = 0
    if (size(values) > 0) integer_of = values(1)
  end function integer_of

  !> All whole numbers of a key; one number for all axes comes back once per axis
  pure function integers_of(scene, group, which, key) result(values)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, key
    integer, intent(in) :: which
    integer, allocatable :: values(:)
    character(len=256), allocatable :: items(:)
    integer :: k, status
    call items_of(scene, group, which, key, [kind_integer], items)
    allocate (values(size(items)))
    do k = 1, size(items)
      call parse_integer(items(k), values(k), status)
    end do
  end function integers_of

  !> A logical; .false. if it is neither written nor has a default
  pure logical function logical_of(scene, group, which, key)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, key
    integer, intent(in) :: which
    character(len=256), allocatable :: items(:)
    integer :: status
    call items_of(scene, group, which, key, [kind_logical], items)
    logical_of = .false.
    if (size(items) > 0) call parse_logical(items(1), logical_of, status)
  end function logical_of

  !> A word, in lower case; empty if it is neither written nor has a default
  pure recursive function word_of(scene, group, which, key) result(word)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, key
    integer, intent(in) :: which
    character(len=:), allocatable :: word
    character(len=256), allocatable :: items(:)
    call items_of(scene, group, which, key, [kind_word], items)
    word = ""
    if (size(items) > 0) word = lower(trim(items(1)))
  end function word_of

  !> A text as written, without trailing blanks; empty if it is neither written nor has a default
  pure function text_of_key(scene, group, which, key) result(text)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, key
    integer, intent(in) :: which
    character(len=:), allocatable :: text
    character(len=256), allocatable :: items(:)
    call items_of(scene, group, which, key, [kind_text, kind_word], items)
    text = ""
    if (size(items) > 0) text = trim(items(1))
  end function text_of_key

  !> All words of a key, in lower case, or all its texts and names
  pure function texts_of(scene, group, which, key) result(texts)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, key
    integer, intent(in) :: which
    character(len=64), allocatable :: texts(:)
    character(len=256), allocatable :: items(:)
    integer :: k
    call items_of(scene, group, which, key, [kind_text, kind_word], items)
    allocate (texts(size(items)))
    do k = 1, size(items)
      texts(k) = items(k)(:64)
      if (scene%key(known_key(scene, group, key))%kind /= kind_word) cycle
      if (.not. takes_names(scene, scene%key(known_key(scene, group, key)))) texts(k) = lower(texts(k))
    end do
  end function texts_of

  !> Whether a key of words takes any name in this scene
  pure logical function takes_names(scene, key)
    type(scene_t), intent(in) :: scene
    type(key_t), intent(in) :: key
    takes_names = key%names_with /= ""
    if (takes_names) takes_names = count_groups(scene, trim(key%names_with)) > 0
  end function takes_names

  !> Add a message about a key to an error: line, group, key, value and what would be right
  pure subroutine complain(error, scene, group, which, key, what)
    type(error_t), allocatable, intent(inout) :: error
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group
    integer, intent(in) :: which
    character(len=*), intent(in) :: key !! empty: about the group as a whole
    character(len=*), intent(in) :: what !! what would be right
    integer :: line
    line = line_of(scene, group, which, key)
    if (line > 0) then
      call add_error(error, "line "//text_of(line)//": "//about(scene, group, which, key, what))
    else
      call add_error(error, about(scene, group, which, key, what))
    end if
  end subroutine complain

  !> The same while the scene is being checked
  pure subroutine note_key(mistakes, scene, group, which, key, what)
    type(mistakes_t), intent(inout) :: mistakes
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, key, what
    integer, intent(in) :: which
    call note_mistake(mistakes, line_of(scene, group, which, key), about(scene, group, which, key, what))
  end subroutine note_key

  !> The same about a group as a whole
  pure subroutine note_group(mistakes, scene, group, which, what)
    type(mistakes_t), intent(inout) :: mistakes
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, what
    integer, intent(in) :: which
    call note_mistake(mistakes, line_of(scene, group, which, ""), "&"//group//": "//what)
  end subroutine note_group

  !> "&group: key = value; what", with the default as value where nothing is written
  pure function about(scene, group, which, key, what) result(text)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, key, what
    integer, intent(in) :: which
    character(len=:), allocatable :: text
    integer :: e, k
    text = "&"//group//": "
    if (key == "") then
      text = text//what
      return
    end if
    e = find_entry(scene, group, which, key)
    k = find_key(scene, group, key)
    if (e > 0) then
      text = text//key//" = "//shown_values(scene%block(find_block(scene, group, which))%entry(e))//"; "//what
    else if (k == 0) then
      text = text//key//"; "//what
    else if (default_of(scene, which, k) /= "") then
      text = text//key//" = "//default_of(scene, which, k)//" (default); "//what
    else
      text = text//key//" is not set; "//what
    end if
  end function about

  !> How many values a key takes in this scene; 0 if it varies or the dimension is not known
  pure integer function count_wanted(scene, key)
    type(scene_t), intent(in) :: scene
    type(key_t), intent(in) :: key
    count_wanted = 0
    select case (key%count)
    case (count_one)
      count_wanted = 1
    case (count_axis, count_one_or_axis)
      count_wanted = scene%dimension
    case (count_tensor)
      count_wanted = scene%dimension**2
    case (count_rotation)
      if (scene%dimension == 2) count_wanted = 1
      if (scene%dimension == 3) count_wanted = 3
    end select
  end function count_wanted

  !> The default of row `k` of the key table in this scene, values with commas between; empty if there is none
  pure recursive function default_of(scene, which, k) result(text)
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: which, k
    character(len=:), allocatable :: text, choice, word, steering
    integer :: i, equals
    text = trim(scene%key(k)%default)
    if (len(text) == 0) return
    if (text(1:1) == "(") text = ""
    if (len(text) == 0) return
    if (text(1:1) /= "?") return
    choice = ""
    steering = blanks(nth_word(text(2:), 1))
    do i = 1, count_words(steering)
      choice = choice//chosen(scene, trim(scene%key(k)%group), which, nth_word(steering, i))//" "
    end do
    do i = 2, count_words(text(2:))
      word = nth_word(text(2:), i)
      equals = index(word, "=")
      if (.not. fits(word(:equals - 1), choice)) cycle
      text = word(equals + 1:)
      return
    end do
    text = ""
  end function default_of

  !> Whether words with commas between are those of a choice; * stands for any word
  pure logical function fits(pattern, choice)
    character(len=*), intent(in) :: pattern, choice
    character(len=:), allocatable :: word
    integer :: i
    fits = .true.
    do i = 1, count_words(blanks(pattern))
      word = nth_word(blanks(pattern), i)
      fits = fits .and. (word == "*" .or. word == nth_word(choice, i))
    end do
  end function fits

  !> A list with blanks in place of its commas
  pure function blanks(list)
    character(len=*), intent(in) :: list
    character(len=len(list)) :: blanks
    integer :: i
    do i = 1, len(list)
      blanks(i:i) = merge(" ", list(i:i), list(i:i) == ",")
    end do
  end function blanks

  !> The value of a key that steers other keys, as a word; "dimension" is the scene's
  pure recursive function chosen(scene, group, which, key) result(word)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, key
    integer, intent(in) :: which
    character(len=:), allocatable :: word
    word = ""
    if (key == "dimension") then
      if (scene%dimension > 0) word = text_of(scene%dimension)
    else if (has_value(scene, group, which, key)) then
      word = word_of(scene, group, which, key)
    end if
  end function chosen

  !> Whether the choices of the group read row `k` of the key table
  pure logical function is_read(scene, which, k)
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: which, k
    is_read = conditions_hold(scene, trim(scene%key(k)%group), which, scene%key(k)%when)
  end function is_read

  !> Whether all of "key=word|word key=word" hold; a choice that is missing or mistaken does not
  pure logical function conditions_hold(scene, group, which, conditions)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, conditions
    integer, intent(in) :: which
    character(len=:), allocatable :: condition, choice
    integer :: i, equals
    conditions_hold = .true.
    do i = 1, count_words(conditions)
      condition = nth_word(conditions, i)
      equals = index(condition, "=")
      choice = chosen(scene, group, which, condition(:equals - 1))
      conditions_hold = conditions_hold .and. choice /= "" .and. &
        index("|"//condition(equals + 1:)//"|", "|"//choice//"|") > 0
    end do
  end function conditions_hold

  !> Whether a key has a value to work with: written without a mistake, or a default
  pure recursive logical function has_value(scene, group, which, key)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, key
    integer, intent(in) :: which
    integer :: e, k
    k = known_key(scene, group, key)
    e = find_entry(scene, group, which, key)
    if (e > 0) then
      has_value = scene%block(find_block(scene, group, which))%entry(e)%sound
    else
      has_value = scene%key(k)%empty_default .or. default_of(scene, which, k) /= ""
    end if
  end function has_value

  !> Whether a key can be worked with: read by the choices made, and written soundly or with a default
  pure logical function usable(scene, group, which, key)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, key
    integer, intent(in) :: which
    usable = is_read(scene, which, find_key(scene, group, key))
    if (usable) usable = has_value(scene, group, which, key)
  end function usable

  !> Row of a group in the table; the program stops if it is not there
  pure integer function known_group(scene, group) result(g)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group
    g = find_group(scene, group)
    if (g == 0) error stop "gimp_scene: the group table has no &"//group
  end function known_group

  !> Row of a key in the table; the program stops if it is not there
  pure integer function known_key(scene, group, key) result(k)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, key
    k = find_key(scene, group, key)
    if (k == 0) error stop "gimp_scene: the key table has no &"//group//" "//key
  end function known_key

  !> The values of a key as text: written, or the default repeated as often as the key wants
  pure recursive subroutine items_of(scene, group, which, key, kinds, items)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, key
    integer, intent(in) :: which
    integer, intent(in) :: kinds(:) !! the kinds that may be asked for in this way
    character(len=256), allocatable, intent(out) :: items(:)
    character(len=:), allocatable :: default
    integer :: k, e, i, n, wanted
    k = known_key(scene, group, key)
    if (all(kinds /= scene%key(k)%kind)) error stop "gimp_scene: wrong kind asked of &"//group//" "//key
    e = find_entry(scene, group, which, key)
    default = ""
    n = 0
    if (e > 0) then
      n = scene%block(find_block(scene, group, which))%entry(e)%n
    else
      default = default_of(scene, which, k)
      n = count_values(default)
    end if
    wanted = n
    if (n == 1) wanted = max(1, count_wanted(scene, scene%key(k)))
    if (n == 1 .and. e > 0 .and. scene%key(k)%count /= count_one_or_axis) wanted = 1
    allocate (items(wanted))
    do i = 1, wanted
      if (e > 0) then
        items(i) = scene%block(find_block(scene, group, which))%entry(e)%item(min(i, n))
      else
        items(i) = nth_value(default, min(i, n))
      end if
    end do
  end subroutine items_of

end module gimp_scene_store
