!> Fields of all particles in the order of their numbers, as frames show them.
!>
!> With several ranks each samples its own particles, and what it sampled is brought to slabs of that order, one to a rank.
module gimp_snapshot
  use gimp_kinds, only: wp, dp, i8, lanes
  use gimp_ranks, only: ranks
  use gimp_over_ranks, only: sum_counts, largest_count
  use gimp_slabs, only: slab_t, slab_of, delivery_t, plan_delivery, bring_to_slab, close_gaps
  use gimp_material, only: most_states
  use gimp_particles, only: few_chunks
  use gimp_engine, only: engine_t
  use gimp_basis, only: basis_cpgimp, is_sampled
  use gimp_verification, only: verification_t, exact_displacement
  use gimp_measures, only: chunk_deformation, chunk_history, chunk_position, chunk_reference, chunk_stress
  implicit none(type, external)
  private
  public :: field_components, field_words, needs_reference, sample_positions, sample_field
  public :: order_t, order_particles, bring_in_order

  character(len=*), parameter :: field_words = "displacement velocity stress smoothed_stress deformation_gradient pressure von_mises " &
    //"equivalent_plastic_strain volume mass density id material body jacobian half_length error reference_position"

  !> The order of numbers, and how particles get there
  type :: order_t
    type(slab_t) :: slab !! of all particles, in the order of numbers
    integer(i8) :: listed = 0 !! particles that this rank samples
    integer(i8), allocatable :: slot(:, :) !! (lane, chunk) where to put what is sampled, 0 for spare lanes
    type(delivery_t), private :: delivery
  end type order_t

contains

  !> Components of a field, 0 for an unknown name
  pure integer function field_components(name) result(n)
    character(len=*), intent(in) :: name
    select case (name)
    case ("displacement", "velocity", "half_length", "error", "reference_position"); n = 3
    case ("stress", "smoothed_stress"); n = 6
    case ("deformation_gradient"); n = 9
    case ("pressure", "von_mises", "equivalent_plastic_strain", "volume", "mass", "density", "id", "material", "body", "jacobian")
      n = 1
    case default; n = 0
    end select
  end function field_components

  !> Whether a field needs the position of particles at the start
  pure logical function needs_reference(name)
    character(len=*), intent(in) :: name
    needs_reference = name == "displacement" .or. name == "error" .or. name == "reference_position"
  end function needs_reference

  !> Put the particles of all ranks in the order of their numbers. Collective
  subroutine order_particles(engine, order)
    type(engine_t), intent(in) :: engine
    type(order_t), intent(out) :: order
    integer(i8), allocatable :: place(:, :)
    integer(i8) :: largest
    largest = 0
    if (engine%particles%chunks > 0) largest = maxval(engine%particles%id)
    largest = largest_count(largest)
    order%slab = slab_of(sum_counts(engine%particles%n))
    order%listed = engine%particles%n
    allocate (order%slot(lanes, engine%particles%chunks))
    if (order%slab%n == largest) then ! nobody is gone: the place is the number
      call copy_numbers(engine, order%slot)
    else if (ranks == 1) then
      call count_numbers(engine, largest, order%slot)
    else
      call copy_numbers(engine, order%slot)
      place = order%slot
      call close_gaps(largest, place, order%slot)
    end if
    if (ranks == 1) return
    place = order%slot
    call plan_delivery(order%slab, place, order%delivery, order%slot)
  end subroutine order_particles

  !> Bring what was sampled to the slabs, where it is in the order of numbers. Collective
  subroutine bring_in_order(order, values)
    type(order_t), intent(in) :: order
    real(dp), allocatable, intent(inout) :: values(:, :) !! in: (component, listed) as sampled; out: (component, slab%mine)
    if (ranks > 1) call bring_to_slab(order%delivery, values)
  end subroutine bring_in_order

  subroutine copy_numbers(engine, place)
    type(engine_t), intent(in) :: engine
    integer(i8), intent(out) :: place(:, :)
    integer :: c
    !$omp parallel do schedule(static) if(engine%particles%chunks > few_chunks)
    do c = 1, engine%particles%chunks
      place(:, c) = engine%particles%id(:, c)
    end do
    !$omp end parallel do
  end subroutine copy_numbers

  !> Places where some numbers are missing, all particles being here
  subroutine count_numbers(engine, largest, place)
    type(engine_t), intent(in) :: engine
    integer(i8), intent(in) :: largest !! number
    integer(i8), intent(out) :: place(:, :)
    integer(i8), allocatable :: upto(:)
    integer(i8) :: k
    integer :: c, l
    allocate (upto(largest), source=0_i8)
    !$omp parallel do schedule(static) private(l) if(engine%particles%chunks > few_chunks)
    do c = 1, engine%particles%chunks
      do l = 1, lanes
        if (engine%particles%id(l, c) > 0) upto(engine%particles%id(l, c)) = 1
      end do
    end do
    !$omp end parallel do
    do k = 2, largest
      upto(k) = upto(k) + upto(k - 1)
    end do
    !$omp parallel do schedule(static) private(l) if(engine%particles%chunks > few_chunks)
    do c = 1, engine%particles%chunks
      do l = 1, lanes
        place(l, c) = 0
        if (engine%particles%id(l, c) > 0) place(l, c) = upto(engine%particles%id(l, c))
      end do
    end do
    !$omp end parallel do
  end subroutine count_numbers

  !> Positions in metres, three components
  subroutine sample_positions(engine, slot, x)
    type(engine_t), intent(in) :: engine
    integer(i8), intent(in) :: slot(:, :) !! (lane, chunk) of `order_t`
    real(dp), intent(out) :: x(:, :) !! (3, listed)
    real(dp) :: here(lanes, 3)
    integer :: g, c, l
    !$omp parallel do schedule(dynamic, 16) private(c, l, here) if(engine%particles%chunks > few_chunks)
    do g = 1, size(engine%particles%groups)
      do c = engine%particles%groups(g)%first, engine%particles%groups(g)%last
        call chunk_position(engine, engine%particles%groups(g), c, here)
        do l = 1, lanes
          if (slot(l, c) > 0) x(:, slot(l, c)) = here(l, :)
        end do
      end do
    end do
    !$omp end parallel do
  end subroutine sample_positions

  !> One field by name
  subroutine sample_field(engine, name, slot, body_first, solution, time, values, smoothed)
    type(engine_t), intent(in) :: engine
    character(len=*), intent(in) :: name
    integer(i8), intent(in) :: slot(:, :) !! (lane, chunk) of `order_t`
    integer(i8), intent(in) :: body_first(:) !! first number of each body, ascending
    type(verification_t), intent(in) :: solution !! used by the field "error" only
    real(dp), intent(in) :: time !! [s]
    real(dp), intent(out) :: values(:, :) !! (components, listed)
    real(wp), intent(in), optional :: smoothed(:, :, :) !! (lane, component, chunk), for the field of that name
    real(dp) :: chunk(lanes, 9)
    integer :: g, c, l, n
    n = field_components(name)
    !$omp parallel do schedule(dynamic, 16) private(c, l, chunk) if(engine%particles%chunks > few_chunks)
    do g = 1, size(engine%particles%groups)
      do c = engine%particles%groups(g)%first, engine%particles%groups(g)%last
        call sample_chunk(engine, name, g, c, body_first, solution, time, chunk, smoothed)
        do l = 1, lanes
          if (slot(l, c) > 0) values(:, slot(l, c)) = chunk(l, :n)
        end do
      end do
    end do
    !$omp end parallel do
  end subroutine sample_field

  subroutine sample_chunk(engine, name, g, c, body_first, solution, time, chunk, smoothed)
    type(engine_t), intent(in) :: engine
    character(len=*), intent(in) :: name
    integer, intent(in) :: g, c
    integer(i8), intent(in) :: body_first(:)
    type(verification_t), intent(in) :: solution
    real(dp), intent(in) :: time
    real(dp), intent(out) :: chunk(lanes, 9)
    real(wp), intent(in), optional :: smoothed(:, :, :)
    real(dp) :: x(lanes, 3), reference(lanes, 3), u(lanes, 3)
    real(wp) :: f(lanes, 9), sigma(lanes, 6), j(lanes), strain(lanes), history(lanes, most_states)
    integer :: d, q, l
    d = engine%grid%dim
    chunk = 0.0_dp
    associate (particles => engine%particles, group => engine%particles%groups(g))
      if (needs_reference(name)) then
        call chunk_reference(engine, c, reference)
        call chunk_position(engine, group, c, x)
      end if
      select case (name)
      case ("displacement")
        chunk(:, :d) = x(:, :d) - reference(:, :d)
      case ("reference_position")
        chunk(:, :d) = reference(:, :d)
      case ("error")
        call exact_displacement(solution, time, reference, u)
        chunk(:, :d) = x(:, :d) - reference(:, :d) - u(:, :d)
      case ("velocity")
        q = particles%velocity%first
        chunk(:, :d) = particles%p(:, q:q + d - 1, c)
      case ("deformation_gradient")
        call chunk_deformation(particles, c, f)
        chunk = f
      case ("smoothed_stress")
        chunk(:, :6) = smoothed(:, :, c)
      case ("mass")
        chunk(:, 1) = particles%p(:, particles%mass%first, c)
      case ("id")
        chunk(:, 1) = real(particles%id(:, c), dp)
      case ("material")
        chunk(:, 1) = group%material
      case ("body")
        do l = 1, lanes
          chunk(l, 1) = count(body_first <= particles%id(l, c))
        end do
      case ("half_length")
        call chunk_half_length(engine, c, chunk)
      case ("equivalent_plastic_strain")
        call chunk_history(particles, c, history)
        call engine%laws(group%material)%law%equivalent_plastic_strain(history, strain)
        chunk(:, 1) = strain
      case default
        call chunk_stress(engine, group, c, sigma, j)
        select case (name)
        case ("stress"); chunk(:, :6) = sigma
        case ("pressure"); chunk(:, 1) = -(sigma(:, 1) + sigma(:, 2) + sigma(:, 3))/3.0_wp
        case ("von_mises")
          chunk(:, 1) = sqrt(0.5_wp*((sigma(:, 1) - sigma(:, 2))**2 + (sigma(:, 2) - sigma(:, 3))**2 &
                                     + (sigma(:, 3) - sigma(:, 1))**2) + 3.0_wp*(sigma(:, 4)**2 + sigma(:, 5)**2 + sigma(:, 6)**2))
        case ("jacobian"); chunk(:, 1) = j
        case ("volume"); chunk(:, 1) = j*particles%p(:, particles%volume%first, c)
        case ("density")
          do l = 1, lanes ! spare lanes have no volume
            if (particles%id(l, c) > 0) chunk(l, 1) = particles%p(l, particles%mass%first, c) &
              /(j(l)*particles%p(l, particles%volume%first, c))
          end do
        end select
      end select
    end associate
  end subroutine sample_chunk

  !> Present half lengths in metres: those the weights use; zero for bases without domains
  pure subroutine chunk_half_length(engine, c, chunk)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: c
    real(dp), intent(inout) :: chunk(lanes, 9)
    integer :: d, k, q
    do k = 1, engine%grid%dim
      chunk(:, k) = engine%overlap*engine%particles%uniform_half(k)
      q = engine%particles%half_length%first
      if (q > 0) chunk(:, k) = engine%overlap*engine%particles%p(:, q + k - 1, c)
      q = engine%particles%domain%first
      if (engine%basis == basis_cpgimp .and. q > 0) chunk(:, k) = engine%particles%p(:, q + k - 1, c)
      if (engine%particles%corner%first > 0) then ! of the box around the domain
        associate (corner => engine%particles%corner, p => engine%particles%p(:, :, c))
          q = corner%first + k - 1
          d = corner%first + corner%components - 1
          chunk(:, k) = 0.5_dp*(maxval(p(:, q:d:engine%grid%dim), dim=2) - minval(p(:, q:d:engine%grid%dim), dim=2))
        end associate
      else if (is_sampled(engine%basis)) then
        d = engine%grid%dim
        chunk(:, k) = sum(abs(engine%particles%p(:, q + k - 1:q + d*(d - 1) + k - 1:d, c)), dim=2)
      end if
      chunk(:, k) = chunk(:, k)*engine%grid%spacing
    end do
  end subroutine chunk_half_length

end module gimp_snapshot
