!> The key table holds what it promises: nothing cut off, defaults that would be accepted, conditions that can hold
program test_scene_table
  use gimp_common_kinds, only: dp
  use gimp_check, only: begin_suite, end_suite, check, check_true
  use gimp_text, only: word_in, count_words, nth_word
  use gimp_scene_keys
  use gimp_scene_values, only: parse_real, parse_integer, parse_logical, in_range, count_values, nth_value
  implicit none(type, external)
  type(key_t), allocatable :: keys(:)
  type(group_t), allocatable :: groups(:)
  integer :: k

  call begin_suite("scene table")
  call list_keys(keys)
  call list_groups(groups)
  do k = 1, size(keys)
    call test_key(keys(k), trim(keys(k)%group)//" "//trim(keys(k)%name))
  end do
  do k = 1, size(groups)
    call check_true(count(groups%name == groups(k)%name) == 1, "group stands once: "//groups(k)%name)
    call check_true(any(keys%group == groups(k)%name) .neqv. groups(k)%planned, "a built group has keys: "//groups(k)%name)
    call check_true(len_trim(groups(k)%purpose) < len(groups(k)%purpose), "purpose not cut: "//groups(k)%name)
  end do
  deallocate (keys, groups) ! the leak check of a sanitizer build looks at main programs too
  call end_suite()

contains

  subroutine test_key(key, what)
    type(key_t), intent(in) :: key
    character(len=*), intent(in) :: what
    integer :: i
    call check_true(count(keys%group == key%group .and. keys%name == key%name) == 1, "key stands once: "//what)
    call check_true(any(groups%name == key%group), "its group is known: "//what)
    ! A full field may have lost its end
    call check_true(len_trim(key%purpose) < len(key%purpose) .and. len_trim(key%words) < len(key%words) .and. &
                    len_trim(key%when) < len(key%when) .and. len_trim(key%default) < len(key%default) .and. &
                    len_trim(key%planned) < len(key%planned) .and. len_trim(key%unit) < len(key%unit) .and. &
                    len_trim(key%range) < len(key%range) .and. len_trim(key%needed_when) < len(key%needed_when), &
                    "nothing is cut off: "//what)
    call check_true(len_trim(key%purpose) > 0, "has a purpose: "//what)
    call check_true((key%kind == kind_word) .eqv. (key%words /= ""), "words belong to word keys: "//what)
    call check_true(key%required .neqv. (key%default /= "" .or. key%empty_default), &
                    "either required or with a default: "//what)
    if (key%unless /= "") call check_true(any(keys%group == key%group .and. keys%name == key%unless), "unless is a key: "//what)
    do i = 1, count_words(key%when)
      call test_condition(key, nth_word(key%when, i), what)
    end do
    do i = 1, count_words(key%needed_when)
      call test_condition(key, nth_word(key%needed_when, i), what)
    end do
    if (key%default == "" .or. key%default(1:1) == "(") return
    if (key%default(1:1) /= "?") then
      call test_default(key, trim(key%default), what)
      return
    end if
    do i = 2, count_words(key%default(2:))
      call test_choice(key, nth_word(key%default(2:), 1), before_equals(nth_word(key%default(2:), i)), what)
      call test_default(key, after_equals(nth_word(key%default(2:), i)), what)
    end do
  end subroutine test_key

  !> "key,key" and "word,*": each key steers, each word is among its own or a star
  recursive subroutine test_choice(key, steering, pattern, what)
    type(key_t), intent(in) :: key
    character(len=*), intent(in) :: steering, pattern, what
    integer :: comma, other
    comma = index(steering//",", ",")
    other = index(pattern//",", ",")
    if (pattern(:other - 1) /= "*") call test_condition(key, steering(:comma - 1)//"="//pattern(:other - 1), what)
    call check_true((comma > len(steering)) .eqv. (other > len(pattern)), "as many words as keys: "//what)
    if (comma <= len(steering) .and. other <= len(pattern)) call test_choice(key, steering(comma + 1:), pattern(other + 1:), what)
  end subroutine test_choice

  !> "key=word|word": the key steers, the words are among its own
  subroutine test_condition(key, condition, what)
    type(key_t), intent(in) :: key
    character(len=*), intent(in) :: condition, what
    character(len=:), allocatable :: words, allowed
    integer :: i, j
    words = after_equals(condition)
    do i = 1, len(words)
      if (words(i:i) == "|") words(i:i) = " "
    end do
    allowed = ""
    do j = 1, size(keys)
      if (keys(j)%group == key%group .and. keys(j)%name == before_equals(condition)) allowed = trim(keys(j)%words)
    end do
    if (before_equals(condition) == "dimension") allowed = "1 2 3"
    do i = 1, count_words(words)
      call check_true(word_in(nth_word(words, i), allowed) > 0, "condition "//condition//" of "//what)
    end do
  end subroutine test_condition

  pure function before_equals(text) result(part)
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: part
    part = text(:index(text, "=") - 1)
  end function before_equals

  pure function after_equals(text) result(part)
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: part
    part = trim(text(index(text, "=") + 1:))
  end function after_equals

  !> A default would be accepted if the author wrote it
  subroutine test_default(key, default, what)
    type(key_t), intent(in) :: key
    character(len=*), intent(in) :: default, what
    real(dp) :: number
    integer :: i, whole, status
    logical :: truth
    do i = 1, count_values(default)
      status = 0
      number = 1.0_dp
      select case (key%kind)
      case (kind_real)
        call parse_real(nth_value(default, i), number, status)
      case (kind_integer)
        call parse_integer(nth_value(default, i), whole, status)
        number = whole
      case (kind_logical)
        call parse_logical(default, truth, status)
      case (kind_word)
        status = merge(0, 1, word_in(nth_value(default, i), key%words) > 0)
      end select
      call check(status, 0, "default of "//what)
      if (key%kind == kind_real .or. key%kind == kind_integer) &
        call check_true(in_range(number, trim(key%range)), "default in range: "//what)
    end do
  end subroutine test_default

end program test_scene_table
