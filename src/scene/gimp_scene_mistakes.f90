!> Mistakes in a scene: collected while it is checked, told in one go in the order of their lines
module gimp_scene_mistakes
  use gimp_error, only: error_t, add_error
  use gimp_text, only: text_of, lower, count_words, nth_word
  implicit none(type, external)
  private
  public :: mistakes_t, note_mistake, tell_mistakes, suggestion, commas, or_list

  type :: mistake_t
    integer :: line = 0 !! 0: about no line in particular
    character(len=:), allocatable :: what
  end type mistake_t

  !> All mistakes found so far
  type :: mistakes_t
    integer :: n = 0
    type(mistake_t), allocatable :: item(:)
  end type mistakes_t

contains

  !> Add a mistake; the same words about the same line are kept once
  pure subroutine note_mistake(mistakes, line, what)
    type(mistakes_t), intent(inout) :: mistakes
    integer, intent(in) :: line !! line of the scene, 0 for none
    character(len=*), intent(in) :: what !! "&group: key = value; what would be right"
    type(mistake_t), allocatable :: wider(:)
    integer :: k
    if (.not. allocated(mistakes%item)) allocate (mistakes%item(16))
    do k = 1, mistakes%n
      if (mistakes%item(k)%line == line .and. mistakes%item(k)%what == what) return
    end do
    if (mistakes%n == size(mistakes%item)) then
      allocate (wider(2*mistakes%n))
      wider(:mistakes%n) = mistakes%item
      call move_alloc(wider, mistakes%item)
    end if
    mistakes%n = mistakes%n + 1
    mistakes%item(mistakes%n)%line = line
    mistakes%item(mistakes%n)%what = what
  end subroutine note_mistake

  !> One message a line, "line 12: ..." in the order of the lines; what has no line comes last
  pure subroutine tell_mistakes(mistakes, error)
    type(mistakes_t), intent(in) :: mistakes
    type(error_t), allocatable, intent(out) :: error !! left alone if there is no mistake
    logical :: told(mistakes%n)
    integer :: k, next, line
    told = .false.
    do
      next = 0
      do k = 1, mistakes%n
        if (told(k)) cycle
        line = mistakes%item(k)%line
        if (next == 0) then
          next = k
        else if (line > 0 .and. (line < mistakes%item(next)%line .or. mistakes%item(next)%line == 0)) then
          next = k
        end if
      end do
      if (next == 0) return
      told(next) = .true.
      if (mistakes%item(next)%line > 0) then
        call add_error(error, "line "//text_of(mistakes%item(next)%line)//": "//mistakes%item(next)%what)
      else
        call add_error(error, mistakes%item(next)%what)
      end if
    end do
  end subroutine tell_mistakes

  !> "did you mean X?" if a known word is near, else "known: ..."
  pure function suggestion(word, known, mark) result(text)
    character(len=*), intent(in) :: word
    character(len=*), intent(in) :: known !! words with a blank between
    character(len=*), intent(in) :: mark !! put before a suggested word, say "&" or a quote (then after it too)
    character(len=:), allocatable :: text, after
    integer :: k, d, best, at
    best = huge(best)
    at = 0
    do k = 1, count_words(known)
      d = distance(lower(word), lower(nth_word(known, k)))
      if (d < best) then
        best = d
        at = k
      end if
    end do
    after = ""
    if (mark == '"') after = mark
    if (at > 0 .and. best <= max(1, len(word)/3)) then
      text = "did you mean "//mark//nth_word(known, at)//after//"?"
    else if (len_trim(known) == 0) then
      text = "there is none to choose from"
    else
      text = "known: "//commas(known)
    end if
  end function suggestion

  !> "a b c" as "a, b, c"
  pure function commas(words) result(text)
    character(len=*), intent(in) :: words
    character(len=:), allocatable :: text
    integer :: k
    text = ""
    do k = 1, count_words(words)
      if (k > 1) text = text//", "
      text = text//nth_word(words, k)
    end do
  end function commas

  !> "a b c" as "a, b or c"
  pure function or_list(words) result(text)
    character(len=*), intent(in) :: words
    character(len=:), allocatable :: text
    integer :: k, n
    n = count_words(words)
    text = ""
    do k = 1, n
      if (k > 1 .and. k == n) then
        text = text//" or "
      else if (k > 1) then
        text = text//", "
      end if
      text = text//nth_word(words, k)
    end do
  end function or_list

  !> Edits between two words; a swap of neighbours counts as one (Damerau 1964, optimal string alignment)
  pure integer function distance(a, b)
    character(len=*), intent(in) :: a, b
    integer :: cost(-1:len(a), -1:len(b)), i, j
    cost = len(a) + len(b) ! row and column -1 are never the cheapest way
    do i = 0, len(a)
      cost(i, 0) = i
    end do
    do j = 0, len(b)
      cost(0, j) = j
    end do
    do j = 1, len(b)
      do i = 1, len(a)
        cost(i, j) = min(cost(i - 1, j), cost(i, j - 1)) + 1
        cost(i, j) = min(cost(i, j), cost(i - 1, j - 1) + merge(0, 1, a(i:i) == b(j:j)))
        if (swapped(a, b, i, j)) cost(i, j) = min(cost(i, j), cost(i - 2, j - 2) + 1)
      end do
    end do
    distance = cost(len(a), len(b))
  end function distance

  !> Whether the two letters up to i and j are the same in reverse
  pure logical function swapped(a, b, i, j)
    character(len=*), intent(in) :: a, b
    integer, intent(in) :: i, j
    swapped = .false.
    if (i < 2 .or. j < 2) return
    swapped = a(i:i) == b(j - 1:j - 1) .and. a(i - 1:i - 1) == b(j:j)
  end function swapped

end module gimp_scene_mistakes
