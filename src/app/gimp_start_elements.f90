!> The elements of a mesh that particles start in
module gimp_start_elements
  use gimp_kinds, only: wp, dp, i8, lanes
  use gimp_error, only: error_t
  use gimp_text, only: text_of, with_thousands
  use gimp_ranks, only: this_rank
  use gimp_over_ranks, only: sum_counts, largest_count, share_reals
  use gimp_search, only: found_t, find_element, found_outside
  use gimp_engine, only: engine_t
  use gimp_population, only: population_t
  use gimp_scene, only: scene_t, complain
  implicit none(type, external)
  private
  public :: find_start_elements

  integer, parameter :: most_told = 3 !! particles outside that a message names

contains

  !> Find the element of every particle; those of no element are told, body by body. Collective
  subroutine find_start_elements(scene, engine, population, error)
    type(scene_t), intent(in) :: scene
    type(engine_t), intent(inout) :: engine
    type(population_t), intent(in) :: population
    type(error_t), allocatable, intent(out) :: error
    type(found_t) :: found
    real(wp) :: x(engine%grid%dim), before(engine%grid%dim)
    integer :: c, l, last, b
    last = 0
    before = 0.0_wp
    associate (p => engine%particles, d => engine%grid%dim)
      ! who owns a point does not depend on where the search starts: with the element of the particle before it is short
      !$omp parallel do schedule(static) firstprivate(last, before) private(l, x, found)
      do c = 1, p%chunks
        do l = 1, lanes
          p%p(l, p%element%first, c) = 0.0_wp
          if (p%id(l, c) == 0) cycle
          x = p%p(l, :d, c)
          call find_element(engine%mesh, engine%locator, engine%search_rule, x, x - before, last, found)
          if (found%how == found_outside) cycle
          last = found%element
          before = x
          p%p(l, p%element%first, c) = last
        end do
        where (p%id(:, c) == 0) p%p(:, p%element%first, c) = p%p(1, p%element%first, c) ! spare lanes are twins
      end do
      !$omp end parallel do
    end associate
    do b = 1, size(population%first)
      call tell_outside(scene, engine, population, b, error)
    end do
  end subroutine find_start_elements

  !> The particles of a body that are in no element. Collective
  subroutine tell_outside(scene, engine, population, b, error)
    type(scene_t), intent(in) :: scene
    type(engine_t), intent(in) :: engine
    type(population_t), intent(in) :: population
    integer, intent(in) :: b
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: words
    integer(i8) :: outside, first, mine
    real(dp) :: x(engine%grid%dim)
    integer :: c, l, k, d, maker
    associate (p => engine%particles)
      outside = 0
      do c = 1, p%chunks
        outside = outside + count([(is_outside(l, c), l=1, lanes)])
      end do
      outside = sum_counts(outside)
      if (outside == 0) return
      words = ""
      first = 0
      do k = 1, int(min(outside, int(most_told, i8)))
        mine = huge(mine) ! number of the next one on this rank
        x = 0.0_dp
        do c = 1, p%chunks
          do l = 1, lanes
            if (p%id(l, c) <= first .or. p%id(l, c) >= mine .or. .not. is_outside(l, c)) cycle
            mine = p%id(l, c)
            x = engine%grid%lower(:engine%grid%dim) + engine%grid%spacing*p%p(l, :engine%grid%dim, c)
          end do
        end do
        first = -largest_count(-mine)
        maker = int(largest_count(merge(int(this_rank, i8), -1_i8, mine == first)))
        call share_reals(maker, x)
        if (k > 1) words = words//", "
        words = words//"particle "//text_of(first)//" at ("//text_of(x(1), 6)
        do d = 2, size(x)
          words = words//", "//text_of(x(d), 6)
        end do
        words = words//")"
      end do
    end associate
    if (outside > most_told) words = words//" and "//with_thousands(outside - most_told)//" more"
    call complain(error, scene, "body", b, "name", "reaches beyond the mesh: "//words//trim(merge(" starts", " start ", outside == 1)) &
                  //" in none of its elements; move or cut the body, or make the mesh larger")

  contains

    !> Whether a lane holds a particle of the body that is in no element
    pure logical function is_outside(l, c)
      integer, intent(in) :: l, c
      associate (p => engine%particles)
        is_outside = p%id(l, c) >= population%first(b) .and. p%id(l, c) < population%first(b) + population%count(b) &
                     .and. p%p(l, p%element%first, c) < 0.5_wp
      end associate
    end function is_outside

  end subroutine tell_outside

end module gimp_start_elements
