!> The scanner: namelist text into groups, keys and values with their lines
program test_scene_text
  use gimp_check, only: begin_suite, end_suite, check, check_true
  use gimp_error, only: error_t
  use gimp_scene_mistakes, only: mistakes_t, tell_mistakes
  use gimp_scene_text, only: line_t, block_t, read_lines, split_lines, join_lines, scan_groups, shown_values
  implicit none(type, external)
  character(len=1), parameter :: nl = new_line("a")
  type(block_t), allocatable :: blocks(:)
  character(len=:), allocatable :: told

  call begin_suite("scene text")
  call test_groups()
  call test_values()
  call test_quotes()
  call test_odd_bytes()
  call test_many()
  call test_mistakes()
  call test_lines_of_a_file()
  deallocate (blocks, told) ! the leak check of a sanitizer build looks at main programs too
  call end_suite()

contains

  !> Scan a text; `told` gets the messages
  subroutine scan_text(text)
    character(len=*), intent(in) :: text
    type(line_t), allocatable :: lines(:)
    type(mistakes_t) :: mistakes
    type(error_t), allocatable :: error
    call split_lines(text, lines)
    if (allocated(blocks)) deallocate (blocks)
    call scan_groups(lines, blocks, mistakes)
    call tell_mistakes(mistakes, error)
    told = ""
    if (allocated(error)) told = error%message
  end subroutine scan_text

  subroutine test_groups()
    call scan_text("! first"//nl//"&A x = 1 / &b y=2,/ &c &end"//nl//nl//"&a"//nl//"z"//nl//" = "//nl//" 3 ! &d w = 4"//nl//"/")
    call check(told, "", "sound groups")
    call check(size(blocks), 4, "groups")
    call check(blocks(1)%name, "a", "names in lower case")
    call check(blocks(2)%entry(1)%name, "y", "several groups on a line")
    call check(blocks(3)%n, 0, "a group closed by &end, without keys")
    call check(blocks(4)%line, 4, "line of a group")
    call check(blocks(4)%entry(1)%line, 5, "line of a key")
    call check(blocks(4)%entry(1)%item(1), "3", "a key over three lines")
    call check(blocks(4)%n, 1, "what a comment holds is not read")
  end subroutine test_groups

  subroutine test_values()
    call scan_text('&a x = 1, 2 3'//nl//'4, y = 3*0.5 2*"ab" t, /')
    call check(told, "", "sound values")
    call check(blocks(1)%entry(1)%n, 4, "commas, blanks and line ends part values")
    call check(blocks(1)%entry(2)%n, 6, "repeat counts")
    call check(blocks(1)%entry(2)%item(3), "0.5", "repeated number")
    call check(blocks(1)%entry(2)%item(5), "ab", "repeated text")
    call check_true(blocks(1)%entry(2)%quoted(5) .and. .not. blocks(1)%entry(2)%quoted(6), "which values are quoted")
    call check(shown_values(blocks(1)%entry(1)), "1, 2, 3, 4", "values shown")
    call scan_text("&a end=3.6/")
    call check(blocks(1)%entry(1)%item(1), "3.6", "a slash ends a number")
  end subroutine test_values

  subroutine test_quotes()
    call scan_text('&a x = "a / ! & = ''b''" y = ''it''''s "so"'' z = "" w="say ""no""" /')
    call check(told, "", "sound quotes")
    call check(blocks(1)%entry(1)%item(1), "a / ! & = 'b'", "everything may stand in quotes")
    call check(blocks(1)%entry(2)%item(1), 'it''s "so"', "doubled single quotes")
    call check(blocks(1)%entry(3)%length(1), 0, "an empty text")
    call check(blocks(1)%entry(4)%item(1), 'say "no"', "doubled quotes")
    call scan_text('&a x = "'//repeat("m", 300)//'" /')
    call check(blocks(1)%entry(1)%length(1), 300, "the length of a long text is known")
  end subroutine test_quotes

  subroutine test_odd_bytes()
    call scan_text(char(239)//char(187)//char(191)//"&a"//achar(9)//"x = 1"//achar(13)//nl//"y ="//achar(9)//"2 /"//achar(13))
    call check(told, "", "byte-order mark, tabs and carriage returns")
    call check(blocks(1)%entry(1)%item(1), "1", "no carriage return in a value")
    call check(blocks(1)%entry(2)%item(1), "2", "a tab before a value")
    call scan_text('&a x = "caf'//char(195)//char(169)//'" /')
    call check(blocks(1)%entry(1)%item(1), "caf"//char(195)//char(169), "text beyond ASCII is kept")
  end subroutine test_odd_bytes

  !> Tables grow: groups, keys, values and tokens beyond their first size
  subroutine test_many()
    character(len=:), allocatable :: text
    integer :: k
    text = ""
    do k = 1, 100
      text = text//"&a b=1 c=2 d=3 e=4 f=5 g=6 h=7 i=8 j=9 k=10 /"//nl
    end do
    call scan_text(text//"&z x = "//repeat("1.25, ", 5000)//" /")
    call check(told, "", "many groups")
    call check(size(blocks), 101, "groups")
    call check(blocks(100)%n, 10, "keys of a late group")
    call check(blocks(101)%entry(1)%n, 5000, "values on one long line")
    call check(blocks(101)%entry(1)%item(5000), "1.25", "the last of them")
    call check(blocks(101)%line, 101, "line of the last group")
  end subroutine test_many

  subroutine test_mistakes()
    call says("&a x = 1", "line 1: &a: the group is not closed; put / at its end")
    call says("&a x = 1"//nl//"&b /", "line 2: &a: the group of line 1 is not closed; put / before &b")
    call says('&a x = "1 /'//nl//"/", 'line 1: &a: the quote before "1 /" is not closed on this line')
    call says('"1 /', 'line 1: the quote before "1 /" is not closed on this line')
    call says("a = 1"//nl//"&b /", 'line 1: "a" stands outside of any group; write &group key = value /')
    call says("&a / /", 'line 1: "/" stands outside of any group; write &group key = value /')
    call says("&a x = /", "line 1: &a: x =; no value follows")
    call says("&a x = y = 2 /", "line 1: &a: x =; no value follows")
    call says("&a x = , 2 /", "line 1: &a: x has an empty value between commas; write every value")
    call says("&a x = 1,,2 /", "line 1: &a: x has an empty value between commas; write every value")
    call says("&a x = 3* /", "line 1: &a: x has an empty value between commas; write every value")
    call says("&a x = 0*1 /", "line 1: &a: x = 0*1; a repeat count must lie between 1 and 100000")
    call says("&a x = 9999999*1 /", "line 1: &a: x = 9999999*1; a repeat count must lie between 1 and 100000")
    call says("&a x(2) = 1 /", "line 1: &a: x(2) = ...; a subscript is not taken, write all values behind x =")
    call says("&a x (2:3) = 1 /", "line 1: &a: x(2:3) = ...; a subscript is not taken, write all values behind x =")
    call says("&a x%y = 1 /", "line 1: &a: x%y = ...; a subscript is not taken, write all values behind x =")
    call says("&a 5 6 /", 'line 1: &a: "5" belongs to no key; write key = value')
    call says("&a = 5 /", "line 1: &a: there is no key before =")
    call check_true(.not. blocks(1)%n > 0, "no key is made of it")
  end subroutine test_mistakes

  subroutine says(text, expected)
    character(len=*), intent(in) :: text, expected
    call scan_text(text)
    call check(told, expected, "messages about '"//text//"'")
  end subroutine says

  !> Lines of any length arrive whole, the last one also without a line end
  subroutine test_lines_of_a_file()
    type(line_t), allocatable :: lines(:)
    integer :: unit, k
    integer, parameter :: lengths(6) = [0, 1, 4095, 4096, 4097, 20000]
    do k = 1, size(lengths)
      open (newunit=unit, status="scratch", access="stream", form="formatted")
      write (unit, "(a)") "first"
      write (unit, "(a)") repeat("x", lengths(k))
      write (unit, "(a)", advance="no") "last"
      rewind (unit)
      call read_lines(unit, lines)
      close (unit)
      call check(size(lines), 3, "number of lines")
      if (size(lines) /= 3) cycle
      call check(len(lines(2)%text), lengths(k), "length of a line")
      call check(lines(3)%text, "last", "the last line has no line end")
      call check(len(join_lines(lines)), lengths(k) + 12, "joined again")
    end do
    call split_lines("a"//nl//nl//"b", lines)
    call check(join_lines(lines), "a"//nl//nl//"b"//nl, "split and joined")
  end subroutine test_lines_of_a_file

end program test_scene_text
