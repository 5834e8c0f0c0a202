!> Bodies become particles: every particle of this rank's share gets its initial state. Who keeps it is settled by the first sort.
module gimp_populate
  use gimp_kinds, only: wp, dp, i8, lanes
  use gimp_error, only: error_t, raise
  use gimp_text, only: text_of
  use gimp_over_ranks, only: share_error, any_rank, largest_count, largest_reals, share_reals
  use gimp_ranks, only: this_rank
  use gimp_fill, only: fill_t
  use gimp_particle_file, only: particle_table_t
  use gimp_particles, only: allot_chunks, clear_chunks, group_t
  use gimp_basis, only: basis_ugimp, longest_half, is_sampled
  use gimp_point_domains, only: half_edges, limit_edges
  use gimp_domains, only: domain_half_lengths
  use gimp_verification, only: verification_t, exact_motion
  use gimp_measures, only: chunk_reference, chunk_deformation
  use gimp_particle_fields, only: announce_fields
  use gimp_run_state, only: stepper_t
  use gimp_material, only: most_states
  use gimp_loads, only: load_point
  use gimp_start_corners, only: box_at, store_corners, deform_corners, exact_corners, settle_corners, corners_in_cells
  use gimp_scene, only: scene_t, count_groups, is_given, reals_of, word_of, text_of_key
  use gimp_setup_sides, only: is_on_particles
  use gimp_setup, only: body_named
  use gimp_population, only: population_t, determinant_of
  use gimp_start_elements, only: find_start_elements
  implicit none(type, external)
  private
  public :: populate

contains

  !> Make the particles of this rank; of `population` only the numbers are left. Collective
  subroutine populate(scene, s, solution, population, error)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(inout) :: s
    type(verification_t), intent(in) :: solution
    type(population_t), intent(inout) :: population
    type(error_t), allocatable, intent(out) :: error
    integer, allocatable :: material_of(:)
    real(wp) :: half(3)
    integer(i8) :: in_material
    integer :: b, m, chunks
    call find_uniform_half(s, population, half)
    call announce_fields(scene, s, half)
    allocate (material_of(count_groups(scene, "body")))
    do b = 1, size(material_of)
      do m = 1, count_groups(scene, "material")
        if (text_of_key(scene, "body", b, "material") == text_of_key(scene, "material", m, "name")) material_of(b) = m
      end do
    end do
    chunks = 0
    allocate (s%engine%particles%groups(0))
    do m = 1, size(s%engine%laws)
      in_material = sum(population%here, mask=material_of == m)
      if (in_material == 0) cycle
      s%engine%particles%groups = [s%engine%particles%groups, &
                                   group_t(0, m, chunks + 1, chunks + int((in_material + lanes - 1)/lanes))]
      chunks = chunks + int((in_material + lanes - 1)/lanes)
    end do
    call allot_chunks(s%engine%particles, chunks)
    call clear_chunks(s%engine%particles)
    do m = 1, size(s%engine%particles%groups)
      call fill_group(scene, s, solution, population, material_of, s%engine%particles%groups(m), error)
      if (allocated(error)) return
    end do
    s%engine%particles%n = sum(population%here)
    s%engine%particles%n_all = population%n
    if (s%engine%grid%is_mesh) call find_start_elements(scene, s%engine, population, error)
    if (allocated(error)) return
    population%fill = fill_t()
    deallocate (population%table)
    if (s%engine%basis == basis_ugimp) call check_extent(s, error)
    if (allocated(error)) return
    if (s%engine%total) call check_undeformed(s, error)
  end subroutine populate

  !> Domains that never change are not shortened: no one may be longer than lists have room for. Collective
  subroutine check_extent(s, error)
    type(stepper_t), intent(in) :: s
    type(error_t), allocatable, intent(out) :: error
    real(dp) :: longest(1)
    associate (p => s%engine%particles)
      longest = maxval(p%uniform_half)
      if (p%half_length%first > 0 .and. p%chunks > 0) &
        longest = maxval(p%p(:, p%half_length%first:p%half_length%first + s%engine%grid%dim - 1, :))
    end associate
    call largest_reals(longest)
    if (.not. s%engine%overlap*real(longest(1), wp) > longest_half) return
    call raise(error, "&method: basis = 'ugimp': a domain reaches "//text_of(real(s%engine%overlap*real(longest(1), wp), dp), 4)// &
               " cells from its particle, domain_overlap included; it may reach "//text_of(real(longest_half, dp)))
  end subroutine check_extent

  !> A total Lagrangian run takes the start for the undeformed state; the first particle that is deformed is told. Collective
  subroutine check_undeformed(s, error)
    type(stepper_t), intent(in) :: s
    type(error_t), allocatable, intent(out) :: error
    real(wp), parameter :: round_off = 8*epsilon(1.0_wp) ! of exact solutions in polar axes
    real(wp) :: f(lanes, 9)
    integer(i8) :: first
    integer :: c, k, l
    first = huge(first)
    do c = 1, s%engine%particles%chunks
      call chunk_deformation(s%engine%particles, c, f)
      do k = 1, 9
        do l = 1, lanes
          if (s%engine%particles%id(l, c) == 0) cycle
          if (abs(f(l, k) - merge(1.0_wp, 0.0_wp, modulo(k, 4) == 1)) > round_off) first = min(first, s%engine%particles%id(l, c))
        end do
      end do
    end do
    first = -largest_count(-first)
    if (first == huge(first)) return
    call raise(error, "&method: formulation = 'total': particle "//text_of(first)//" starts deformed; bodies must start " &
               //"undeformed, with F = I")
  end subroutine check_undeformed

  !> Half lengths in cells if all particles share them, else zero; they are those of particle 1. Collective
  subroutine find_uniform_half(s, population, half)
    type(stepper_t), intent(in) :: s
    type(population_t), intent(in) :: population
    real(wp), intent(out) :: half(3)
    real(dp) :: hinv, first(s%engine%grid%dim)
    logical :: differ
    integer :: d, k, maker
    d = s%engine%grid%dim
    hinv = 1.0_dp/s%engine%grid%spacing
    half = 0.0_wp
    do k = 1, size(population%table)
      if (allocated(population%table(k)%position)) return
    end do
    maker = int(largest_count(merge(int(this_rank, i8), -1_i8, any(population%from == 1 .and. population%here > 0))))
    first = 0.0_dp
    if (maker == this_rank) first = population%fill%half_length(:, 1)
    call share_reals(maker, first)
    differ = .false.
    do k = 1, d
      differ = differ .or. any(abs(population%fill%half_length(k, :) - first(k))*hinv > 1.0e-12_dp)
    end do
    if (any_rank(differ)) return
    half(:d) = real(first*hinv, wp)
  end subroutine find_uniform_half

  !> The particles of one material, in the order of bodies
  subroutine fill_group(scene, s, solution, population, material_of, group, error)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(inout) :: s
    type(verification_t), intent(in) :: solution
    type(population_t), intent(in) :: population
    integer, intent(in) :: material_of(:)
    type(group_t), intent(in) :: group
    type(error_t), allocatable, intent(out) :: error
    real(wp), allocatable :: stress(:, :, :)
    integer(i8) :: i, before
    integer :: b, c, l
    allocate (stress(lanes, 6, group%first:merge(group%last, group%first, has_stress())), source=0.0_wp)
    before = 0 ! particles of the group in the bodies before this one
    do b = 1, size(material_of)
      if (material_of(b) /= group%material) cycle
      !$omp parallel do schedule(static) private(c, l)
      do i = 1, population%here(b)
        c = group%first + int((before + i - 1)/lanes)
        l = 1 + int(modulo(before + i - 1, int(lanes, i8)))
        s%engine%particles%id(l, c) = population%from(b) + i - 1
        call place_particle(s, population, b, i, group%material, l, c, stress(:, :, min(c, ubound(stress, 3))))
      end do
      !$omp end parallel do
      before = before + population%here(b)
      call start_body(scene, s, solution, population, b)
    end do
    c = group%last
    do l = 1 + int(modulo(before - 1, int(lanes, i8))) + 1, lanes ! spare lanes of the last chunk: twins without mass
      s%engine%particles%p(l, :, c) = s%engine%particles%p(1, :, c)
      s%engine%particles%p(l, s%engine%particles%mass%first, c) = 0.0_wp
      s%engine%particles%p(l, s%engine%particles%volume%first, c) = 0.0_wp
    end do
    call start_states(s, group, stress)

  contains

    !> Whether some particle of the group begins with a stress; else one chunk of zeros serves all
    pure logical function has_stress()
      integer :: k
      has_stress = .false.
      do k = 1, size(material_of)
        if (material_of(k) == group%material) has_stress = has_stress .or. allocated(population%table(k)%stress)
      end do
    end function has_stress

  end subroutine fill_group

  !> Position, mass, volume, half lengths and what a file says about one particle
  subroutine place_particle(s, population, b, i, material, l, c, stress)
    type(stepper_t), intent(inout) :: s
    type(population_t), intent(in) :: population
    integer, intent(in) :: b, material, l, c
    integer(i8), intent(in) :: i
    real(wp), intent(inout) :: stress(lanes, 6)
    real(dp) :: x(3), half(3), f(9), hinv, j
    integer(i8) :: q
    integer :: d, k
    d = s%engine%grid%dim
    hinv = 1.0_dp/s%engine%grid%spacing
    associate (p => s%engine%particles, table => population%table(b), fill => population%fill)
      f(:d*d) = 0.0_dp
      f(1:d*d:d + 1) = 1.0_dp
      half = 0.0_dp
      x = 0.0_dp
      if (allocated(table%position)) then
        x(:d) = table%position(:, i)
        if (allocated(table%deformation_gradient)) f(:d*d) = table%deformation_gradient(:, i)
        p%p(l, p%mass%first, c) = real(table%mass(i), wp)
        j = determinant_of(d, f)
        p%p(l, p%volume%first, c) = real(table%volume(i)/j, wp)
        if (allocated(table%velocity)) p%p(l, p%velocity%first:p%velocity%first + d - 1, c) = real(table%velocity(:, i), wp)
        half(:d) = 0.5_dp*(table%volume(i)/j)**(1.0_dp/d)*hinv
        if (allocated(table%half_length)) half(:d) = table%half_length(:, i)*hinv
        if (allocated(table%stress)) stress(l, :) = real(table%stress(:, i), wp)
      else
        q = fill%first(b) + i - 1
        x(:d) = fill%position(:, q)
        p%p(l, p%volume%first, c) = real(fill%volume(q), wp)
        p%p(l, p%mass%first, c) = real(fill%volume(q)*s%engine%laws(material)%law%density, wp)
        half(:d) = fill%half_length(:, q)*hinv
        if (p%faces%first > 0) p%p(l, p%faces%first, c) = fill%faces(q) ! turned into load marks by start_body
      end if
      do k = 1, d
        p%p(l, k, c) = real((x(k) - s%engine%grid%lower(k))*hinv, wp)
        if (p%reference%first > 0) p%p(l, p%reference%first + k - 1, c) = p%p(l, k, c)
        if (p%half_length%first > 0) p%p(l, p%half_length%first + k - 1, c) = real(half(k), wp)
      end do
      p%p(l, p%deformation%first:p%deformation%first + d*d - 1, c) = real(f(:d*d), wp)
      if (p%corner%first == 0) return
      if (allocated(table%corner)) then
        call store_corners(p, l, c, corners_in_cells(s%engine, table%corner(:, i)))
      else if (fill%keeps(b)) then
        call store_corners(p, l, c, (fill%corner(:, :, q) - spread(s%engine%grid%lower(:d), 2, s%engine%rule%n))*hinv)
      else
        call store_corners(p, l, c, box_at(d, (x(:d) - s%engine%grid%lower(:d))*hinv, half(:d)))
        if (allocated(table%deformation_gradient)) call deform_corners(p, l, c, f)
      end if
    end associate
  end subroutine place_particle

  !> Initial velocity, deformation and load marks of a body, or the state of the exact solution
  subroutine start_body(scene, s, solution, population, b)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(inout) :: s
    type(verification_t), intent(in) :: solution
    type(population_t), intent(in) :: population
    integer, intent(in) :: b
    real(dp) :: velocity(3), spin(3), center(3), gradient(3, 3), x(3), f(9)
    real(dp), allocatable :: given(:)
    integer(i8) :: marks, faces
    integer(i8), allocatable :: loaded(:) ! (load) faces that it acts on
    integer :: d, c, l, k, g
    logical :: exact, has_f
    d = scene%dimension
    exact = word_of(scene, "body", b, "initial") == "verification"
    velocity = 0.0_dp
    spin = 0.0_dp
    gradient = 0.0_dp
    center = population%center(:, b)
    has_f = is_given(scene, "body", b, "deformation_gradient")
    if (is_given(scene, "body", b, "velocity")) velocity(:d) = reals_of(scene, "body", b, "velocity")
    if (is_given(scene, "body", b, "angular_velocity")) then
      given = reals_of(scene, "body", b, "angular_velocity")
      if (d == 2) spin(3) = given(1)
      if (d == 3) spin = given
    end if
    if (is_given(scene, "body", b, "velocity_gradient")) then
      gradient(:d, :d) = transpose(reshape(reals_of(scene, "body", b, "velocity_gradient"), [d, d]))
    end if
    gradient = gradient + reshape([0.0_dp, spin(3), -spin(2), -spin(3), 0.0_dp, spin(1), spin(2), -spin(1), 0.0_dp], [3, 3])
    if (is_given(scene, "body", b, "rotation_center")) center(:d) = reals_of(scene, "body", b, "rotation_center")
    if (has_f) f(:d*d) = reals_of(scene, "body", b, "deformation_gradient")
    loaded = [(faces_of_load(scene, s, k, b), k=1, size(s%loads%load))] ! here: what reads the scene is not for several threads at once

    associate (p => s%engine%particles)
      do g = 1, size(p%groups)
        !$omp parallel do schedule(static) private(l, k, x, faces, marks)
        do c = p%groups(g)%first, p%groups(g)%last
          if (exact) call start_exactly(s, solution, population, b, c)
          do l = 1, lanes
            if (p%id(l, c) < population%first(b) .or. p%id(l, c) >= population%first(b) + population%count(b)) cycle
            if (has_f) p%p(l, p%deformation%first:p%deformation%first + d*d - 1, c) = real(f(:d*d), wp)
            if (has_f .and. p%corner%first > 0) call deform_corners(p, l, c, f)
            if (.not. exact .and. .not. allocated(population%table(b)%velocity)) then
              x = 0.0_dp
              x(:d) = s%engine%grid%lower(:d) + s%engine%grid%spacing*p%p(l, :d, c) - center(:d)
              x = velocity + matmul(gradient, x)
              p%p(l, p%velocity%first:p%velocity%first + d - 1, c) = real(x(:d), wp)
              do k = 1, merge(d, 0, p%affine%first > 0) ! what affine transfers carry is there from the start
                p%p(l, p%affine%first + d*(k - 1):p%affine%first + d*k - 1, c) = real(gradient(k, :d), wp)
              end do
            end if
            if (p%faces%first == 0) cycle
            faces = nint(p%p(l, p%faces%first, c), i8)
            marks = 0
            do k = 1, size(s%loads%load)
              marks = ior(marks, shiftl(iand(faces, loaded(k)), 6*s%loads%load(k)%place))
            end do
            p%p(l, p%faces%first, c) = real(marks, wp)
          end do
        end do
        !$omp end parallel do
      end do
    end associate
  end subroutine start_body

  !> Faces (bits x_low, x_high, y_low, ...) of a body that a load acts on
  integer(i8) function faces_of_load(scene, s, k, b) result(faces)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(in) :: s
    integer, intent(in) :: k, b
    character(len=:), allocatable :: side
    integer :: group, n
    faces = 0
    if (s%loads%load(k)%kind == load_point) return
    n = 0
    do group = 1, count_groups(scene, "load") ! the k-th load on particles
      if (is_on_particles(scene, group)) n = n + 1
      if (n == k) exit
    end do
    if (body_named(scene, text_of_key(scene, "load", group, "body")) /= b) return
    side = word_of(scene, "load", group, "face")
    faces = 63
    if (side /= "all") faces = ibset(0_i8, 2*(index("xyz", side(1:1)) - 1) + merge(1, 0, side(3:) == "high"))
  end function faces_of_load

  !> Position, velocity and deformation of the exact solution at t = 0
  subroutine start_exactly(s, solution, population, b, c)
    type(stepper_t), intent(inout) :: s
    type(verification_t), intent(in) :: solution
    type(population_t), intent(in) :: population
    integer, intent(in) :: b, c
    real(dp) :: x(lanes, 3), u(lanes, 3), v(lanes, 3), f(lanes, 9)
    logical :: mine(lanes)
    integer :: d, i, j, k, l
    d = s%engine%grid%dim
    associate (p => s%engine%particles)
      call chunk_reference(s%engine, c, x)
      do l = 1, lanes
        if (p%id(l, c) == 0) x(l, :) = x(1, :)
      end do
      call exact_motion(solution, 0.0_dp, x, u, v, f)
      mine = p%id(:, c) >= population%first(b) .and. p%id(:, c) < population%first(b) + population%count(b)
      if (p%corner%first > 0 .and. any(mine)) call exact_corners(s%engine, solution, c, mine)
      do l = 1, lanes
        if (.not. mine(l)) cycle
        do k = 1, d
          p%p(l, k, c) = real(p%p(l, k, c) + u(l, k)/s%engine%grid%spacing, wp)
          p%p(l, p%velocity%first + k - 1, c) = real(v(l, k), wp)
        end do
        do i = 1, d
          do j = 1, d
            p%p(l, p%deformation%first + d*(i - 1) + j - 1, c) = real(f(l, 3*(i - 1) + j), wp)
          end do
        end do
      end do
    end associate
  end subroutine start_exactly

  !> Material state and domains from the initial deformation and stress
  subroutine start_states(s, group, stress)
    type(stepper_t), intent(inout) :: s
    type(group_t), intent(in) :: group
    real(wp), intent(in) :: stress(:, :, :) !! (lane, component, chunk of the group), or one chunk for all [Pa]
    real(wp) :: f(lanes, 9), half0(lanes, 3), half(lanes, 3), history(lanes, most_states)
    integer :: c, d, i, j, k, q, clamped
    d = s%engine%grid%dim
    associate (p => s%engine%particles, law => s%engine%laws(group%material)%law)
      !$omp parallel do schedule(static) private(f, half0, half, history, i, j, k, q, clamped)
      do c = group%first, group%last
        f = 0.0_wp
        f(:, 1:9:4) = 1.0_wp
        do i = 1, d
          do j = 1, d
            f(:, 3*(i - 1) + j) = p%p(:, p%deformation%first + d*(i - 1) + j - 1, c)
          end do
        end do
        q = p%evened%first
        if (q > 0) p%p(:, q:q + d*d - 1, c) = p%p(:, p%deformation%first:p%deformation%first + d*d - 1, c)
        if (law%states > 0) then
          history = 0.0_wp
          call law%start_state(f, stress(:, :, min(c - group%first + 1, size(stress, 3))), history)
          q = p%state%first
          p%p(:, q:q + p%state%components - 1, c) = history(:, :p%state%components)
        end if
        if (p%corner%first > 0) call settle_corners(s%engine, c, f)
        if (p%domain%first == 0) cycle
        do k = 1, 3
          half0(:, k) = s%engine%overlap*p%uniform_half(k)
        end do
        q = p%half_length%first
        if (q > 0) half0(:, :d) = s%engine%overlap*p%p(:, q:q + d - 1, c)
        clamped = 0
        q = p%domain%first
        if (is_sampled(s%engine%basis)) then
          call half_edges(d, f, half0, p%p(:, q:q + d*d - 1, c))
          call limit_edges(d, s%engine%longest_diagonal, p%p(:, q:q + d*d - 1, c), clamped)
        else
          call domain_half_lengths(s%engine%domain_rule, d, f, half0, half, clamped)
          p%p(:, q:q + d - 1, c) = half(:, :d)
        end if
      end do
      !$omp end parallel do
    end associate
  end subroutine start_states

end module gimp_populate
