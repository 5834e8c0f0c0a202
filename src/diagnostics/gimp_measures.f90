!> What is measured on the particles: energies, momenta, errors against an exact solution, and the hash of the state.
!>
!> Every sum is formed per group of particles and then added exactly, so that it does not depend on how a run is cut.
module gimp_measures
  use gimp_kinds, only: wp, dp, i8, lanes
  use gimp_over_ranks, only: sum_columns, sum_counts, largest_reals
  use gimp_hash_table, only: mix_bits
  use gimp_over_ranks, only: smallest_reals, largest_count, join_reals
  use gimp_tensor, only: determinant
  use gimp_material, only: most_states
  use gimp_particles, only: particles_t, group_t, few_chunks
  use gimp_engine, only: engine_t
  use gimp_chunk_state, only: chunk_deformation, chunk_law_deformation, chunk_history
  use gimp_splines, only: make_spline
  use gimp_basis, only: weight_list_t, inertia_of_list, spline_degree
  use gimp_particle_list, only: particle_list
  use gimp_verification, only: verification_t, exact_motion, exact_stress
  implicit none(type, external)
  private
  public :: totals_t, errors_t, measure_totals, measure_errors, state_hash, chunk_deformation, chunk_history, chunk_position, chunk_reference, chunk_stress
  public :: find_particle, nearest_particle, measure_probes, probe_values

  !> Sums over all particles
  type :: totals_t
    real(dp) :: mass = 0.0_dp !! [kg]
    real(dp) :: kinetic = 0.0_dp !! [J]
    real(dp) :: stored = 0.0_dp !! elastic energy [J]
    real(dp) :: momentum(3) = 0.0_dp !! [kg m/s]
    real(dp) :: angular_momentum(3) = 0.0_dp !! about the origin of coordinates [kg m2/s]
    real(dp) :: speed = 0.0_dp !! largest [m/s]
  end type totals_t

  !> Norms of the error, weighted by initial volume; not yet divided by a scale
  type :: errors_t
    real(dp) :: rms = 0.0_dp, max = 0.0_dp !! of positions [m]
    real(dp) :: rms_velocity = 0.0_dp, max_velocity = 0.0_dp !! [m/s]
    real(dp) :: rms_stress = 0.0_dp, max_stress = 0.0_dp !! Frobenius norm of the Cauchy stress [Pa]
  end type errors_t

contains

  !> Positions of a chunk in metres; zero in axes beyond the dimension
  pure subroutine chunk_position(engine, group, c, x)
    type(engine_t), intent(in) :: engine
    type(group_t), intent(in) :: group
    integer, intent(in) :: c
    real(dp), intent(out) :: x(lanes, 3)
    integer :: k, u
    x = 0.0_dp
    do k = 1, engine%grid%dim
      x(:, k) = engine%grid%lower(k) + engine%grid%spacing*(real(engine%particles%p(:, k, c), dp) + group%at(k)*engine%grid%edge(k))
    end do
    u = engine%particles%displacement%first
    if (u == 0) return
    do k = 1, engine%grid%dim
      x(:, k) = x(:, k) + engine%grid%spacing*real(engine%particles%p(:, u + k - 1, c), dp)
    end do
  end subroutine chunk_position

  !> Positions of a chunk at the start in metres; zero in axes beyond the dimension
  pure subroutine chunk_reference(engine, c, x)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: c
    real(dp), intent(out) :: x(lanes, 3)
    integer :: k
    x = 0.0_dp
    do k = 1, engine%grid%dim
      x(:, k) = engine%grid%lower(k) + engine%grid%spacing*engine%particles%p(:, engine%particles%reference%first + k - 1, c)
    end do
  end subroutine chunk_reference

  !> Cauchy stress of a chunk [Pa] and its J
  subroutine chunk_stress(engine, group, c, sigma, j)
    type(engine_t), intent(in) :: engine
    type(group_t), intent(in) :: group
    integer, intent(in) :: c
    real(wp), intent(out) :: sigma(lanes, 6), j(lanes)
    real(wp) :: f(lanes, 9), speed2(lanes), history(lanes, most_states), j_law(lanes)
    integer :: k
    call chunk_deformation(engine%particles, c, f)
    call determinant(f, j)
    call chunk_law_deformation(engine%particles, c, f)
    call determinant(f, j_law)
    call chunk_history(engine%particles, c, history)
    call engine%laws(group%material)%law%kirchhoff(f, history, sigma, speed2)
    do k = 1, 6
      sigma(:, k) = sigma(:, k)/j_law
    end do
  end subroutine chunk_stress

  !> Sums over all particles. Collective
  subroutine measure_totals(engine, totals)
    type(engine_t), intent(in) :: engine
    type(totals_t), intent(out) :: totals
    real(dp), allocatable :: part(:, :), speed(:) ! (sum, group)
    real(dp) :: sums(9), largest(1)
    integer :: g
    allocate (part(9, size(engine%particles%groups)), speed(size(engine%particles%groups)))
    !$omp parallel do schedule(dynamic, 16) &
    !$omp if(engine%particles%chunks > few_chunks)
    do g = 1, size(engine%particles%groups)
      call measure_group(engine, g, part(:, g), speed(g))
    end do
    !$omp end parallel do
    call sum_columns(part, sums)
    totals%mass = sums(1)
    totals%kinetic = sums(2)
    totals%stored = sums(3)
    totals%momentum = sums(4:6)
    totals%angular_momentum = sums(7:9)
    largest = maxval([0.0_dp, speed])
    call largest_reals(largest)
    totals%speed = largest(1)
  end subroutine measure_totals

  !> Mass, kinetic and stored energy, momentum and angular momentum of a group, and its largest speed
  subroutine measure_group(engine, g, sums, speed)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: g
    real(dp), intent(out) :: sums(9), speed
    real(wp) :: f(lanes, 9), energy(lanes), v(lanes, 3), history(lanes, most_states)
    real(dp) :: x(lanes, 3), m, mv(3)
    integer :: c, l, d
    d = engine%grid%dim
    sums = 0.0_dp
    speed = 0.0_dp
    associate (particles => engine%particles, group => engine%particles%groups(g))
      do c = group%first, group%last
        call chunk_law_deformation(particles, c, f)
        call chunk_position(engine, group, c, x)
        v = 0.0_wp
        v(:, :d) = particles%p(:, particles%velocity%first:particles%velocity%first + d - 1, c)
        call chunk_history(particles, c, history)
        call engine%laws(group%material)%law%stored_energy(f, history, energy)
        do l = 1, lanes
          m = real(particles%p(l, particles%mass%first, c), dp)
          mv = m*real(v(l, :), dp)
          sums(1) = sums(1) + m
          sums(2) = sums(2) + 0.5_dp*dot_product(mv, real(v(l, :), dp))
          sums(3) = sums(3) + real(particles%p(l, particles%volume%first, c), dp)*real(energy(l), dp)
          sums(4:6) = sums(4:6) + mv
          sums(7:9) = sums(7:9) + [x(l, 2)*mv(3) - x(l, 3)*mv(2), x(l, 3)*mv(1) - x(l, 1)*mv(3), x(l, 1)*mv(2) - x(l, 2)*mv(1)]
          if (particles%affine%first > 0) sums(7:9) = sums(7:9) + affine_spin(engine, group%at, c, l, m)
          speed = max(speed, sqrt(sum(real(v(l, :), dp)**2)))
        end do
      end do
    end associate
  end subroutine measure_group

  !> Angular momentum of the velocity gradient that a particle carries: m (C D - (C D)^T) (Jiang et al. 2015) [kg m2/s]
  pure function affine_spin(engine, at, c, l, m) result(spin)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: at(3), c, l !! block, chunk, lane
    real(dp), intent(in) :: m
    real(dp) :: spin(3)
    type(weight_list_t) :: list
    real(wp) :: inertia(3, 3), f(lanes, 9), center(3)
    real(dp) :: b(3, 3)
    integer :: d, k, q
    d = engine%grid%dim
    associate (p => engine%particles)
      call particle_list(engine, at, c, l, list)
      center(:d) = p%p(l, 1:d, c)
      do k = 1, d ! corners that move with the grid carry the centre of their domain along
        if (p%corner%first > 0) center(k) = sum(list%s(:list%n)*list%node(k, :list%n))
      end do
      inertia = inertia_of_list(d, center, make_spline(spline_degree(engine%basis), engine%grid, at), list)
      if (engine%total) then ! arms to nodes are those of the start; F turns them
        call chunk_deformation(p, c, f)
        inertia = matmul(inertia, reshape(f(l, :), [3, 3]))
      end if
      b = 0.0_dp
      do k = 1, d
        q = p%affine%first + d*(k - 1)
        b(k, :d) = m*engine%grid%spacing**2*real(matmul(p%p(l, q:q + d - 1, c), inertia(:d, :d)), dp)
      end do
    end associate
    spin = [b(3, 2) - b(2, 3), b(1, 3) - b(3, 1), b(2, 1) - b(1, 2)]
  end function affine_spin

  !> Errors against the exact solution. Velocities of a leap-frog run are those of an earlier time, which the caller gives.
  subroutine measure_errors(engine, solution, time, velocity_time, errors)
    type(engine_t), intent(in) :: engine
    type(verification_t), intent(in) :: solution
    real(dp), intent(in) :: time, velocity_time !! [s]
    type(errors_t), intent(out) :: errors
    real(dp), allocatable :: part(:, :), largest(:, :) ! (sum, group): of position, velocity, stress, volume
    real(dp) :: sums(4), all_largest(3)
    integer :: g
    allocate (part(4, size(engine%particles%groups)), largest(3, size(engine%particles%groups)))
    !$omp parallel do schedule(dynamic, 16) &
    !$omp if(engine%particles%chunks > few_chunks)
    do g = 1, size(engine%particles%groups)
      call group_errors(engine, solution, time, velocity_time, engine%particles%groups(g), part(:, g), largest(:, g))
    end do
    !$omp end parallel do
    call sum_columns(part, sums)
    if (sums(4) > 0.0_dp) sums(:3) = sqrt(sums(:3)/sums(4))
    errors%rms = sums(1)
    errors%rms_velocity = sums(2)
    errors%rms_stress = sums(3)
    all_largest = maxval(reshape([[0.0_dp, 0.0_dp, 0.0_dp], largest], [3, size(largest, 2) + 1]), dim=2)
    call largest_reals(all_largest)
    errors%max = sqrt(all_largest(1))
    errors%max_velocity = sqrt(all_largest(2))
    errors%max_stress = sqrt(all_largest(3))
  end subroutine measure_errors

  !> Squared errors of a group: sums over its particles times volume, its volume, and the largest ones
  subroutine group_errors(engine, solution, time, velocity_time, group, sums, largest)
    type(engine_t), intent(in) :: engine
    type(verification_t), intent(in) :: solution
    real(dp), intent(in) :: time, velocity_time !! [s]
    type(group_t), intent(in) :: group
    real(dp), intent(out) :: sums(4), largest(3)
    real(wp) :: sigma(lanes, 6), j(lanes)
    real(dp) :: x(lanes, 3), reference(lanes, 3), u(lanes, 3), v(lanes, 3), f(lanes, 9), exact(lanes, 6), ignored(lanes, 3)
    real(dp) :: e(3), w
    integer :: c, l, d
    d = engine%grid%dim
    sums = 0.0_dp
    largest = 0.0_dp
    associate (particles => engine%particles)
      do c = group%first, group%last
        call chunk_position(engine, group, c, x)
        call chunk_reference(engine, c, reference)
        call exact_motion(solution, velocity_time, reference, ignored, v, f)
        call exact_motion(solution, time, reference, u, ignored, f)
        call exact_stress(solution, time, reference, exact)
        call chunk_stress(engine, group, c, sigma, j)
        do l = 1, lanes
          if (particles%id(l, c) == 0) cycle
          w = real(particles%p(l, particles%volume%first, c), dp)
          e(1) = sum((x(l, :d) - reference(l, :d) - u(l, :d))**2)
          e(2) = sum((particles%p(l, particles%velocity%first:particles%velocity%first + d - 1, c) - v(l, :d))**2)
          e(3) = sum((sigma(l, :3) - exact(l, :3))**2) + 2.0_dp*sum((sigma(l, 4:) - exact(l, 4:))**2)
          sums(:3) = sums(:3) + w*e
          sums(4) = sums(4) + w
          largest = max(largest, e)
        end do
      end do
    end associate
  end subroutine group_errors

  !> Order-free hash of the whole state: the sum over particles of hash(id, block, bits of every live field), plus step and
  !> time. Two runs with the same hash have the same bits. Collective
  integer(i8) function state_hash(engine, step, time) result(hash)
    type(engine_t), intent(in) :: engine
    integer(i8), intent(in) :: step
    real(dp), intent(in) :: time
    integer(i8) :: h, part
    integer :: g, c, l, f
    part = 0
    associate (particles => engine%particles)
      !$omp parallel do schedule(dynamic, 16) private(c, l, f, h) reduction(+:part) &
    !$omp if(engine%particles%chunks > few_chunks)
      do g = 1, size(particles%groups)
        do c = particles%groups(g)%first, particles%groups(g)%last
          do l = 1, lanes
            if (particles%id(l, c) == 0) cycle
            h = mix_bits(particles%id(l, c))
            do f = 1, 3
              h = mix_bits(ieor(h, int(particles%groups(g)%at(f), i8)))
            end do
            do f = 1, particles%components
              h = mix_bits(ieor(h, transfer(real(particles%p(l, f, c), dp), 0_i8)))
            end do
            part = part + h
          end do
        end do
      end do
      !$omp end parallel do
    end associate
    hash = mix_bits(step) + mix_bits(transfer(time, 0_i8)) + sum_counts(part)
  end function state_hash

  !> Chunk and lane of the particle with a number; chunk 0 when this rank does not have it
  subroutine find_particle(particles, id, group, c, l)
    type(particles_t), intent(in) :: particles
    integer(i8), intent(in) :: id
    integer, intent(out) :: group, c, l
    integer :: k, g, i, found
    group = 0
    c = 0
    l = 0
    found = 0 ! no two lanes have the same number
    !$omp parallel do schedule(static) private(i) reduction(max:found) if(particles%chunks > few_chunks)
    do k = 1, particles%chunks
      do i = 1, lanes
        if (particles%id(i, k) == id) found = k
      end do
    end do
    !$omp end parallel do
    if (found == 0) return
    c = found
    l = findloc(particles%id(:, c), id, dim=1)
    do g = 1, size(particles%groups)
      if (particles%groups(g)%last >= c) exit
    end do
    group = g
  end subroutine find_particle

  !> How many values a probe has
  pure integer function probe_values(dim)
    integer, intent(in) :: dim
    probe_values = 2*dim + 4
  end function probe_values

  !> Position [m], velocity [m/s] and stress xx, yy, zz, xy [Pa] of some particles, on all ranks whichever has them; zero where a
  !> particle is gone. Collective
  subroutine measure_probes(engine, id, values)
    type(engine_t), intent(in) :: engine
    integer(i8), intent(in) :: id(:)
    real(dp), intent(out) :: values(:, :) !! (probe_values(dim), probe)
    real(dp) :: x(lanes, 3)
    real(wp) :: sigma(lanes, 6), j(lanes)
    integer :: k, g, c, l, d
    d = engine%grid%dim
    values = 0.0_dp
    do k = 1, size(id)
      call find_particle(engine%particles, id(k), g, c, l)
      if (c == 0) cycle
      associate (p => engine%particles)
        call chunk_position(engine, p%groups(g), c, x)
        call chunk_stress(engine, p%groups(g), c, sigma, j)
        values(:, k) = [x(l, :d), real(p%p(l, p%velocity%first:p%velocity%first + d - 1, c), dp), real(sigma(l, :4), dp)]
      end associate
    end do
    call join_reals(values)
  end subroutine measure_probes

  !> The particle nearest to a point, the one with the smallest number where several are equally near; numbers may be limited. 0
  !> when there is none. Collective
  integer(i8) function nearest_particle(engine, point, first, last) result(id)
    type(engine_t), intent(in) :: engine
    real(dp), intent(in) :: point(:) !! (dim) [m]
    integer(i8), intent(in) :: first, last !! range of numbers
    real(dp), allocatable :: distance(:)
    integer(i8), allocatable :: candidate(:)
    real(dp) :: nearest, nearest_of_all(1)
    integer :: g
    allocate (distance(size(engine%particles%groups)), candidate(size(engine%particles%groups)))
    !$omp parallel do schedule(dynamic, 16) &
    !$omp if(engine%particles%chunks > few_chunks)
    do g = 1, size(engine%particles%groups)
      call nearest_in_group(engine, engine%particles%groups(g), point, first, last, candidate(g), distance(g))
    end do
    !$omp end parallel do
    id = 0
    nearest = huge(1.0_dp)
    do g = 1, size(candidate)
      if (candidate(g) == 0 .or. distance(g) > nearest .or. (distance(g) == nearest .and. candidate(g) > id)) cycle
      nearest = distance(g)
      id = candidate(g)
    end do
    nearest_of_all = nearest
    call smallest_reals(nearest_of_all)
    if (id == 0 .or. nearest > nearest_of_all(1)) id = huge(id)
    id = -largest_count(-id)
    if (id == huge(id)) id = 0
  end function nearest_particle

  subroutine nearest_in_group(engine, group, point, first, last, id, nearest)
    type(engine_t), intent(in) :: engine
    type(group_t), intent(in) :: group
    real(dp), intent(in) :: point(:)
    integer(i8), intent(in) :: first, last
    integer(i8), intent(out) :: id
    real(dp), intent(out) :: nearest !! squared distance [m2]
    real(dp) :: x(lanes, 3), r2
    integer :: c, l, d
    d = engine%grid%dim
    id = 0
    nearest = huge(1.0_dp)
    do c = group%first, group%last
      call chunk_position(engine, group, c, x)
      do l = 1, lanes
        associate (this => engine%particles%id(l, c))
          if (this < max(1_i8, first) .or. this > last) cycle
          r2 = sum((x(l, :d) - point(:d))**2)
          if (r2 > nearest .or. (r2 == nearest .and. this > id)) cycle
          nearest = r2
          id = this
        end associate
      end do
    end do
  end subroutine nearest_in_group

end module gimp_measures
