!> The text of a scene: standard input read once, cut into groups and "key = values", every piece with its line.
!>
!> Why not the namelist read of the runtime: it has no line numbers, skips unknown groups, takes `nan`, cuts long strings
!> and stops at the first mistake. The syntax is that of a namelist: commas or blanks between values, repeat counts such as
!> 3*0.0, quotes of both kinds with doubled quotes inside, comments after an exclamation mark, several groups on a line or
!> one over many, a group closed by a slash or &end. Words and texts need their quotes. Subscripts (key(2) = ...) and null
!> values (1,,3) are refused: the whole list is written, so that nobody has to remember what was there before.
module gimp_scene_text
  use gimp_text, only: lower, text_of
  use gimp_scene_mistakes, only: mistakes_t, note_mistake
  use gimp_scene_values, only: parse_integer, quoted_text
  implicit none(type, external)
  private
  public :: entry_t, block_t, line_t, read_lines, split_lines, join_lines, scan_groups, put_text_value, shown_values

  integer, parameter :: item_most = 256 !! characters of a value that are kept
  integer, parameter :: repeat_most = 100000 !! a larger repeat count is a slip of the pen

  !> A line of the scene
  type :: line_t
    character(len=:), allocatable :: text
  end type line_t

  !> A key with its values as written
  type :: entry_t
    character(len=:), allocatable :: name !! lower case
    integer :: line = 0
    integer :: n = 0 !! values
    character(len=item_most), allocatable :: item(:) !! (n or more)
    integer, allocatable :: length(:) !! characters of each value, also those beyond item_most
    logical, allocatable :: quoted(:)
    logical :: sound = .true. !! no mistake was found in it
  end type entry_t

  !> A group as it stands in the scene
  type :: block_t
    character(len=:), allocatable :: name !! lower case
    integer :: line = 0
    integer :: n = 0 !! keys
    type(entry_t), allocatable :: entry(:) !! (n or more)
  end type block_t

  integer, parameter :: token_group = 1, token_close = 2, token_bare = 3, token_quoted = 4, token_equals = 5, token_comma = 6

  !> The smallest piece of a scene
  type :: token_t
    integer :: what = 0
    integer :: line = 0
    logical :: glued = .false. !! nothing stands between it and the token before it
    logical :: whole = .true. !! false: its quote is not closed
    character(len=:), allocatable :: text
  end type token_t

contains

  !> All lines of a unit, once and forwards: a pipe cannot be rewound
  subroutine read_lines(unit, lines)
    integer, intent(in) :: unit
    type(line_t), allocatable, intent(out) :: lines(:)
    character(len=4096) :: buffer
    character(len=:), allocatable :: line
    integer :: n, status, got
    allocate (lines(64))
    n = 0
    line = ""
    do
      read (unit, "(a)", advance="no", iostat=status, size=got) buffer
      if (is_iostat_end(status) .and. len(line) == 0) exit
      if (status > 0) exit
      if (status == 0) then
        line = line//buffer
        cycle
      end if
      if (is_iostat_eor(status)) line = line//buffer(:got)
      call append_line(lines, n, line)
      line = ""
      if (is_iostat_end(status)) exit
    end do
    lines = lines(:n)
  end subroutine read_lines

  pure subroutine append_line(lines, n, text)
    type(line_t), allocatable, intent(inout) :: lines(:)
    integer, intent(inout) :: n
    character(len=*), intent(in) :: text
    type(line_t), allocatable :: wider(:)
    if (n == size(lines)) then
      allocate (wider(2*n))
      wider(:n) = lines
      call move_alloc(wider, lines)
    end if
    n = n + 1
    lines(n)%text = text
  end subroutine append_line

  !> A text with new lines inside as lines
  pure subroutine split_lines(text, lines)
    character(len=*), intent(in) :: text
    type(line_t), allocatable, intent(out) :: lines(:)
    integer :: n, i, first
    allocate (lines(64))
    n = 0
    first = 1
    do i = 1, len(text)
      if (text(i:i) /= new_line("a")) cycle
      call append_line(lines, n, text(first:i - 1))
      first = i + 1
    end do
    if (first <= len(text)) call append_line(lines, n, text(first:))
    lines = lines(:n)
  end subroutine split_lines

  !> Lines as one text, each ended by a new line
  pure function join_lines(lines) result(text)
    type(line_t), intent(in) :: lines(:)
    character(len=:), allocatable :: text
    integer :: k, n
    n = 0
    do k = 1, size(lines)
      n = n + len(lines(k)%text) + 1
    end do
    allocate (character(len=n) :: text)
    n = 0
    do k = 1, size(lines)
      text(n + 1:n + len(lines(k)%text) + 1) = lines(k)%text//new_line("a")
      n = n + len(lines(k)%text) + 1
    end do
  end function join_lines

  !> The values of a key as they stand in the scene, cut when they are many
  pure function shown_values(entry) result(text)
    type(entry_t), intent(in) :: entry
    character(len=:), allocatable :: text, item
    integer :: k
    text = ""
    do k = 1, entry%n
      item = entry%item(k)(:min(entry%length(k), item_most))
      if (len(item) > 48) item = item(:45)//"..."
      if (entry%quoted(k)) item = quoted_text(item)
      if (k > 1) text = text//", "
      text = text//item
      if (len(text) > 60 .and. k < entry%n) then
        text = text//", ..."
        return
      end if
    end do
  end function shown_values

  !> Cut lines into groups; what is not a group or not "key = values" is noted
  pure subroutine scan_groups(lines, blocks, mistakes)
    type(line_t), intent(in) :: lines(:)
    type(block_t), allocatable, intent(out) :: blocks(:)
    type(mistakes_t), intent(inout) :: mistakes
    type(token_t), allocatable :: tokens(:)
    integer :: n_tokens, n, k, outside
    allocate (tokens(256), blocks(16))
    n_tokens = 0
    do k = 1, size(lines)
      call cut_line(lines(k)%text, k, tokens, n_tokens)
    end do
    n = 0
    outside = 0
    k = 1
    do while (k <= n_tokens)
      if (tokens(k)%what == token_group) then
        call new_block(blocks, n, tokens(k))
        call fill_block(tokens, n_tokens, k, blocks(n), mistakes)
        cycle
      end if
      if (tokens(k)%line /= outside) then
        outside = tokens(k)%line
        if (tokens(k)%whole) then
          call note_mistake(mistakes, outside, '"'//tokens(k)%text//'" stands outside of any group; write &group key = value /')
        else
          call note_mistake(mistakes, outside, open_quote(tokens(k)%text))
        end if
      end if
      k = k + 1
    end do
    blocks = blocks(:n)
  end subroutine scan_groups

  pure subroutine new_block(blocks, n, token)
    type(block_t), allocatable, intent(inout) :: blocks(:)
    integer, intent(inout) :: n
    type(token_t), intent(in) :: token
    type(block_t), allocatable :: wider(:)
    if (n == size(blocks)) then
      allocate (wider(2*n))
      wider(:n) = blocks
      call move_alloc(wider, blocks)
    end if
    n = n + 1
    blocks(n)%name = token%text
    blocks(n)%line = token%line
    allocate (blocks(n)%entry(8))
  end subroutine new_block

  !> From the token behind the group's name to the one behind its end
  pure subroutine fill_block(tokens, n_tokens, k, block, mistakes)
    type(token_t), intent(in) :: tokens(:)
    integer, intent(in) :: n_tokens
    integer, intent(inout) :: k !! in: the group's token; out: the first behind the group
    type(block_t), intent(inout) :: block
    type(mistakes_t), intent(inout) :: mistakes
    logical :: in_key !! a key is open for values
    logical :: after_comma
    integer :: loose
    in_key = .false.
    after_comma = .false.
    loose = 0
    k = k + 1
    do while (k <= n_tokens)
      select case (tokens(k)%what)
      case (token_close)
        if (in_key) call finish_entry(block, mistakes)
        k = k + 1
        return
      case (token_group)
        if (in_key) call finish_entry(block, mistakes)
        call note_mistake(mistakes, tokens(k)%line, "&"//block%name//": the group of line "//text_of(block%line)// &
                          " is not closed; put / before &"//tokens(k)%text)
        return
      case (token_equals)
        call note_mistake(mistakes, tokens(k)%line, "&"//block%name//": there is no key before =")
        loose = tokens(k)%line ! what follows belongs to the same slip
      case (token_comma)
        if (in_key) then
          if (after_comma .or. block%entry(block%n)%n == 0) call note_empty(block, tokens(k)%line, mistakes)
        end if
        after_comma = .true.
        k = k + 1
        cycle
      case default
        if (key_ahead(tokens, n_tokens, k)) then
          if (in_key) call finish_entry(block, mistakes)
          call new_entry(block, tokens, k, mistakes)
          in_key = .true.
        else if (.not. tokens(k)%whole) then
          if (in_key) block%entry(block%n)%sound = .false.
          call note_mistake(mistakes, tokens(k)%line, "&"//block%name//": "//open_quote(tokens(k)%text))
        else if (in_key) then
          call take_value(block, tokens, n_tokens, k, mistakes)
        else if (tokens(k)%line /= loose) then
          loose = tokens(k)%line
          call note_mistake(mistakes, loose, "&"//block%name//': "'//tokens(k)%text//'" belongs to no key; write key = value')
        end if
      end select
      after_comma = .false.
      k = k + 1
    end do
    if (in_key) call finish_entry(block, mistakes)
    call note_mistake(mistakes, block%line, "&"//block%name//": the group is not closed; put / at its end")
  end subroutine fill_block

  !> Whether "name =" or "name (2) =" stands at token k
  pure logical function key_ahead(tokens, n_tokens, k)
    type(token_t), intent(in) :: tokens(:)
    integer, intent(in) :: n_tokens, k
    key_ahead = .false.
    if (tokens(k)%what /= token_bare .or. k == n_tokens) return
    key_ahead = tokens(k + 1)%what == token_equals
    if (key_ahead .or. tokens(k + 1)%what /= token_bare .or. k + 1 >= n_tokens) return
    key_ahead = tokens(k + 1)%text(1:1) == "(" .and. tokens(k + 2)%what == token_equals
  end function key_ahead

  !> Begin a key at token k; k then stands on its equals sign
  pure subroutine new_entry(block, tokens, k, mistakes)
    type(block_t), intent(inout) :: block
    type(token_t), intent(in) :: tokens(:)
    integer, intent(inout) :: k
    type(mistakes_t), intent(inout) :: mistakes
    type(entry_t), allocatable :: wider(:)
    character(len=:), allocatable :: name
    integer :: mark
    if (block%n == size(block%entry)) then
      allocate (wider(2*block%n))
      wider(:block%n) = block%entry
      call move_alloc(wider, block%entry)
    end if
    block%n = block%n + 1
    name = lower(tokens(k)%text)
    if (tokens(k + 1)%what /= token_equals) then
      name = name//tokens(k + 1)%text
      k = k + 1
    end if
    mark = scan(name, "(%")
    if (mark > 1) then
      call note_mistake(mistakes, tokens(k)%line, "&"//block%name//": "//name//" = ...; a subscript is not taken, "// &
                        "write all values behind "//name(:mark - 1)//" =")
      name = name(:mark - 1)
      block%entry(block%n)%sound = .false.
    end if
    block%entry(block%n)%name = name
    block%entry(block%n)%line = tokens(k)%line
    allocate (block%entry(block%n)%item(4), block%entry(block%n)%length(4), block%entry(block%n)%quoted(4))
    k = k + 1
  end subroutine new_entry

  pure subroutine finish_entry(block, mistakes)
    type(block_t), intent(inout) :: block
    type(mistakes_t), intent(inout) :: mistakes
    if (block%entry(block%n)%n > 0) return
    if (block%entry(block%n)%sound) then
      call note_mistake(mistakes, block%entry(block%n)%line, "&"//block%name//": "//block%entry(block%n)%name// &
                        " =; no value follows")
    end if
    block%entry(block%n)%sound = .false.
  end subroutine finish_entry

  pure function open_quote(text) result(what)
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: what
    what = "the quote before "//quoted_text(text(:min(32, len(text))))//" is not closed on this line"
  end function open_quote

  pure subroutine note_empty(block, line, mistakes)
    type(block_t), intent(inout) :: block
    integer, intent(in) :: line
    type(mistakes_t), intent(inout) :: mistakes
    call note_mistake(mistakes, line, "&"//block%name//": "//block%entry(block%n)%name// &
                      " has an empty value between commas; write every value")
    block%entry(block%n)%sound = .false.
  end subroutine note_empty

  !> The value at token k, with its repeat count; k stays on the last token that was used
  pure subroutine take_value(block, tokens, n_tokens, k, mistakes)
    type(block_t), intent(inout) :: block
    type(token_t), intent(in) :: tokens(:)
    integer, intent(in) :: n_tokens
    integer, intent(inout) :: k
    type(mistakes_t), intent(inout) :: mistakes
    integer :: star, times, status, r
    times = 1
    star = 0
    if (tokens(k)%what == token_bare) star = index(tokens(k)%text, "*")
    if (star > 1) then
      call parse_integer(tokens(k)%text(:star - 1), times, status)
      if (status /= 0) then
        times = 1
        star = 0 ! not a repeat count; the check of the value will say so
      else if (times < 1 .or. times > repeat_most) then
        call note_mistake(mistakes, tokens(k)%line, "&"//block%name//": "//block%entry(block%n)%name//" = "// &
                          tokens(k)%text//"; a repeat count must lie between 1 and "//text_of(repeat_most))
        block%entry(block%n)%sound = .false.
        return
      end if
    else
      star = 0
    end if
    if (star > 0 .and. star == len(tokens(k)%text)) then
      r = min(k + 1, n_tokens)
      if (r == k .or. tokens(r)%what /= token_quoted .or. .not. tokens(r)%glued) then
        call note_empty(block, tokens(k)%line, mistakes)
        return
      end if
      k = r
      star = 0
    end if
    do r = 1, times
      call add_value(block%entry(block%n), tokens(k)%text(star + 1:), tokens(k)%what == token_quoted)
    end do
  end subroutine take_value

  pure subroutine add_value(entry, text, quoted)
    type(entry_t), intent(inout) :: entry
    character(len=*), intent(in) :: text
    logical, intent(in) :: quoted
    character(len=item_most), allocatable :: items(:)
    integer, allocatable :: lengths(:)
    logical, allocatable :: flags(:)
    integer :: n
    n = entry%n
    if (n == size(entry%item)) then
      allocate (items(2*n), lengths(2*n), flags(2*n))
      items(:n) = entry%item
      lengths(:n) = entry%length
      flags(:n) = entry%quoted
      call move_alloc(items, entry%item)
      call move_alloc(lengths, entry%length)
      call move_alloc(flags, entry%quoted)
    end if
    entry%n = n + 1
    entry%item(n + 1) = text
    entry%length(n + 1) = len(text)
    entry%quoted(n + 1) = quoted
  end subroutine add_value

  !> Cut one line into tokens
  pure subroutine cut_line(line, number, tokens, n)
    character(len=*), intent(in) :: line
    integer, intent(in) :: number !! of the line
    type(token_t), allocatable, intent(inout) :: tokens(:)
    integer, intent(inout) :: n
    character(len=*), parameter :: letters = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_"
    character(len=:), allocatable :: text
    integer :: i, j, last
    logical :: closed
    i = 1
    last = 0
    if (number == 1 .and. index(line, char(239)//char(187)//char(191)) == 1) i = 4 ! byte-order mark
    do while (i <= len(line))
      if (is_blank(line(i:i))) then
        i = i + 1
        cycle
      end if
      select case (line(i:i))
      case ("!")
        return
      case ("'", '"')
        call cut_quoted(line, i, j, text, closed)
        call add_token(tokens, n, token_quoted, number, i == last + 1, text)
        tokens(n)%whole = closed
      case ("=")
        j = i
        call add_token(tokens, n, token_equals, number, .false., "=")
      case (",")
        j = i
        call add_token(tokens, n, token_comma, number, .false., ",")
      case ("/")
        j = i
        call add_token(tokens, n, token_close, number, .false., "/")
      case ("&")
        j = i + verify(line(i + 1:)//" ", letters) - 1
        text = lower(line(i + 1:j))
        call add_token(tokens, n, merge(token_close, token_group, text == "end"), number, .false., text)
      case default
        j = end_of_bare(line, i)
        call add_token(tokens, n, token_bare, number, i == last + 1, line(i:j))
      end select
      last = j
      i = j + 1
    end do
  end subroutine cut_line

  pure logical function is_blank(c)
    character(len=1), intent(in) :: c
    is_blank = iachar(c) <= 32 .or. iachar(c) == 127
  end function is_blank

  !> Last character of the word or number that begins at `first`; brackets belong to it with all they hold
  pure integer function end_of_bare(line, first) result(last)
    character(len=*), intent(in) :: line
    integer, intent(in) :: first
    integer :: close
    last = first - 1
    do while (last < len(line))
      if (is_blank(line(last + 1:last + 1))) return
      if (scan(line(last + 1:last + 1), "=,/!&'""") == 1) return
      last = last + 1
      if (line(last:last) /= "(") cycle
      close = index(line(last:), ")")
      if (close > 0) last = last + close - 1
    end do
  end function end_of_bare

  !> A text between quotes; the doubled quote inside stands for one
  pure subroutine cut_quoted(line, first, last, text, closed)
    character(len=*), intent(in) :: line
    integer, intent(in) :: first !! the opening quote
    integer, intent(out) :: last !! the closing one, or the end of the line
    character(len=:), allocatable, intent(out) :: text
    logical, intent(out) :: closed
    character(len=len(line)) :: buffer
    integer :: n
    closed = .false.
    n = 0
    last = first
    do while (last < len(line))
      last = last + 1
      if (line(last:last) == line(first:first)) then
        closed = .true.
        if (last == len(line)) exit
        if (line(last + 1:last + 1) /= line(first:first)) exit
        closed = .false.
        last = last + 1
      end if
      n = n + 1
      buffer(n:n) = line(last:last)
      if (iachar(line(last:last)) < 32) buffer(n:n) = " " ! tabs and the like
    end do
    text = buffer(:n)
    if (.not. closed) text = trim(text)
  end subroutine cut_quoted

  pure subroutine add_token(tokens, n, what, line, glued, text)
    type(token_t), allocatable, intent(inout) :: tokens(:)
    integer, intent(inout) :: n
    integer, intent(in) :: what, line
    logical, intent(in) :: glued
    character(len=*), intent(in) :: text
    type(token_t), allocatable :: wider(:)
    if (n == size(tokens)) then
      allocate (wider(2*n))
      wider(:n) = tokens
      call move_alloc(wider, tokens)
    end if
    n = n + 1
    tokens(n)%what = what
    tokens(n)%line = line
    tokens(n)%glued = glued
    tokens(n)%text = text
  end subroutine add_token

  !> Write a text key as if it stood in the scene, in place of what stands there; it has no line
  pure subroutine put_text_value(blocks, group, key, value)
    type(block_t), allocatable, intent(inout) :: blocks(:)
    character(len=*), intent(in) :: group, key, value
    type(block_t) :: added
    integer :: b, e
    do b = 1, size(blocks)
      if (blocks(b)%name == group) exit
    end do
    if (b > size(blocks)) then
      added%name = group
      allocate (added%entry(0))
      blocks = [blocks, added]
    end if
    associate (block => blocks(b))
      do e = 1, block%n
        if (block%entry(e)%name == key) exit
      end do
      if (e > size(block%entry)) block%entry = [block%entry, entry_t()]
      block%n = max(block%n, e)
      block%entry(e) = entry_t(name=key, n=1, length=[len(value)], quoted=[.true.])
      allocate (block%entry(e)%item(1))
      block%entry(e)%item(1) = value
    end associate
  end subroutine put_text_value

end module gimp_scene_text
