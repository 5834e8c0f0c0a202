!> Help and input reference name every group, key and word
program test_scene_help
  use gimp_check, only: begin_suite, end_suite, check, check_true
  use gimp_error, only: error_t
  use gimp_text, only: count_words, nth_word
  use gimp_scene, only: help_text, group_help, write_reference
  use gimp_scene_keys, only: key_t, group_t, list_keys, list_groups
  implicit none(type, external)
  type(key_t), allocatable :: keys(:)
  type(group_t), allocatable :: groups(:)

  call begin_suite("scene help")
  call list_keys(keys)
  call list_groups(groups)
  call test_help()
  call test_group_help()
  call test_reference()
  deallocate (keys, groups) ! the leak check of a sanitizer build looks at main programs too
  call end_suite()

contains

  subroutine test_help()
    character(len=:), allocatable :: text
    integer :: g
    call help_text(text)
    do g = 1, size(groups)
      call check_true(index(text, "&"//trim(groups(g)%name)) > 0, "--help names &"//groups(g)%name)
    end do
    call check_true(index(text, "exit codes") > 0 .and. index(text, "--check") > 0, "--help tells usage and exit codes")
  end subroutine test_help

  subroutine test_group_help()
    character(len=:), allocatable :: text, again
    type(error_t), allocatable :: error
    integer :: k, w
    do k = 1, size(keys)
      call group_help(trim(keys(k)%group), text, error)
      call check_true(.not. allocated(error), "help of &"//keys(k)%group)
      call check_true(index(text, new_line("a")//"  "//trim(keys(k)%name)//" ") > 0, "help names "//keys(k)%name)
      call check_true(index(text, trim(keys(k)%purpose)) > 0, "help says what it is for: "//keys(k)%name)
      do w = 1, count_words(keys(k)%words)
        call check_true(index(text, nth_word(keys(k)%words, w)) > 0, "help names the word "//nth_word(keys(k)%words, w))
      end do
    end do
    call group_help("&Time", again, error)
    call group_help("time", text, error)
    call check(again, text, "& and capitals make no difference")
    call check_true(index(text, "courant") > 0 .and. index(text, "not together with steps") > 0, "keys that exclude each other")
    call group_help("tiem", text, error)
    call check_true(allocated(error), "an unknown group")
    call check(error%message, "&tiem: there is no such group; did you mean &time?", "its message")
    call group_help("contact", text, error)
    call check_true(index(text, "planned, not built yet") > 0, "a planned group says so")
  end subroutine test_group_help

  !> Every table row has as many columns as its head
  subroutine test_reference()
    character(len=2000) :: line
    integer :: unit, status, rows, bars, k
    open (newunit=unit, status="scratch", form="formatted")
    call write_reference(unit)
    rewind (unit)
    rows = 0
    do
      read (unit, "(a)", iostat=status) line
      if (status /= 0) exit
      if (line(1:1) /= "|") cycle
      bars = 0
      do k = 1, len_trim(line)
        if (line(k:k) == "|") bars = bars + 1
      end do
      call check(bars, 6, "columns of "//line(:24))
      if (line(1:3) == "| `") rows = rows + 1
    end do
    close (unit)
    call check(rows, size(keys), "a row for every key")
  end subroutine test_reference

end program test_scene_help
