!> The critical time step of the present state, which the Courant number does not see: in partially filled cells light nodes
!> carry the stiffness of whole particles.
!>
!> With lumped nodal masses M, weights and stiffness frozen, a step is stable while dt <= 2/sqrt(lambda), lambda the largest
!> eigenvalue of W M^-1 K. K is the stiffness of the particles on the grid,
!>   K_ij = sum_p m_p c_p^2 [lambda' G_i (x) G_j + mu' (G_j (x) G_i + G_i.G_j I)],  lambda' + 2 mu' = 1,
!> with the present bound c_p of the wave speed. W says which velocity strains the particles. With the smoothing
!> P = M^-1 S^T m S (grid to particles and back, eigenvalues between 0 and 1) one finds, from the amplification of the
!> step at its root -1:
!> - usl: u' = u + dt (v + dt a), v' = v + dt P a, so W = 2 - P;
!> - generalised alpha: W = 1 and its own limit in place of 2 (gimp_generalized_alpha);
!> - musl, usf, usavg: the grid velocity that strains has been through the particles, W = P (times 2/(1 + q) with a FLIP
!>   fraction q); with affine transfers, which smooth less, W = 1.
!> One particle at the share xi of a cell has lambda(M^-1 K) = c^2/(h^2 xi (1 - xi)) and P a = 0: the limit of usl is
!> (h/c) sqrt(2 xi (1 - xi)); with musl it is always stable.
!>
!> Two ways to lambda: `gershgorin` (rigorous, two sweeps over the particles, pessimistic) and `lanczos` (measured to about a
!> per cent from below, some twenty sweeps). A sweep walks weight lists and is rare. Blocks collect in pads, which nodes add in a
!> fixed order as in a step: every sum has one order on any number of threads and ranks. The pads of the step are put aside meanwhile.
module gimp_stability
  use gimp_kinds, only: wp, dp, lanes
  use gimp_over_ranks, only: sum_of, largest_reals
  use gimp_grid, only: node_at_place, nodes_per_block, nf => fields_per_node, has_images
  use gimp_blocks, only: neighbour, few_blocks
  use gimp_basis, only: weight_list_t
  use gimp_particle_list, only: particle_list
  use gimp_engine, only: engine_t, pad_edge
  use gimp_aside, only: aside_t, put_aside, bring_back
  use gimp_pads, only: sum_pads, add_spills
  use gimp_list_kernel, only: wide_nodes, wide_place, unload_wide, order_spill
  use gimp_borders, only: send_pads
  use gimp_particle_pass, only: allot_spills, tell_signs, complete_pads
  use gimp_chunk_state, only: chunk_deformation, chunk_history
  use gimp_material, only: most_states
  use gimp_walls, only: walls_t, constrain
  use omp_lib, only: omp_get_thread_num
  implicit none(type, external)
  private
  public :: critical_step, check_none, check_gershgorin, check_lanczos, check_of_word, check_word, strains_plain, strains_after_kick, &
    strains_smoothed

  integer, parameter :: check_none = 0, check_gershgorin = 1, check_lanczos = 2
  character(len=10), parameter :: words(0:2) = [character(len=10) :: "none", "gershgorin", "lanczos"]
  integer, parameter :: strains_plain = 1 !! W = 1
  integer, parameter :: strains_after_kick = 2 !! W = 2 - P
  integer, parameter :: strains_smoothed = 3 !! W = P
  integer, parameter :: give_mass = 1, give_stiffness = 2, give_smoothing = 3, give_rows = 4
  integer, parameter :: most_lanczos = 40 !! steps; some 20 are usual
  real(wp), parameter :: enough = 5.0e-4_wp !! change of lambda in one step of the iteration at which it ends

  !> What the sweeps share: node values are (component, node of block, slot)
  type :: frozen_t
    real(wp), allocatable :: stiffness(:, :) !! (lane, chunk) m_p c_p^2 [J]
    real(wp), allocatable :: bulk(:) !! (material) lambda' = lambda/(lambda + 2 mu)
    real(wp), allocatable :: per_mass(:, :) !! (node, slot) 1/m, 0 for nodes that are left out [1/kg]
    logical, allocatable :: held(:) !! (slot) some node of it is held by a side
  end type frozen_t

contains

  !> Number of a check from its word, -1 for an unknown one
  pure integer function check_of_word(word) result(check)
    character(len=*), intent(in) :: word
    check = findloc(words, word, dim=1) - 1
  end function check_of_word

  !> The word of a check
  pure function check_word(check) result(word)
    integer, intent(in) :: check
    character(len=:), allocatable :: word
    word = trim(words(check))
  end function check_word

  !> The critical step of the present state [s]; huge if nothing limits it. The engine is left as it was. Collective
  subroutine critical_step(engine, walls, held, cutoff, check, strains, factor, dt)
    type(engine_t), intent(inout) :: engine
    type(walls_t), intent(in) :: walls
    logical, intent(in) :: held(:) !! (slot) some node of it is held by a side
    real(wp), intent(in) :: cutoff !! nodes with less mass are left out [kg]
    integer, intent(in) :: check !! check_gershgorin or check_lanczos
    integer, intent(in) :: strains !! what strains the particles: strains_*
    real(wp), intent(in) :: factor !! on lambda
    real(dp), intent(out) :: dt
    type(frozen_t) :: frozen
    type(aside_t) :: aside
    real(dp) :: lambda
    call put_aside(engine, aside)
    call freeze(engine, cutoff, held, frozen)
    if (check == check_gershgorin) then
      call bound_rows(engine, frozen, lambda)
      if (strains == strains_after_kick) lambda = 2.0_dp*lambda ! 2 - P <= 2
    else
      call iterate(engine, walls, frozen, strains, lambda)
    end if
    call bring_back(engine, aside)
    lambda = lambda*factor
    dt = huge(1.0_dp)
    if (lambda > 0.0_dp) dt = 2.0_dp*engine%grid%spacing/sqrt(lambda)
  end subroutine critical_step

  !> Stiffness of the particles and masses of the nodes
  subroutine freeze(engine, cutoff, held, frozen)
    type(engine_t), intent(inout) :: engine
    real(wp), intent(in) :: cutoff
    logical, intent(in) :: held(:)
    type(frozen_t), intent(out) :: frozen
    real(wp), allocatable :: mass(:, :, :), none(:, :, :)
    real(wp) :: f(lanes, 9), history(lanes, most_states), tau(lanes, 6), speed2(lanes)
    integer :: g, c, m
    frozen%held = held
    allocate (frozen%stiffness(lanes, engine%particles%chunks), frozen%bulk(size(engine%laws)))
    do m = 1, size(engine%laws)
      frozen%bulk(m) = engine%laws(m)%law%lambda/(engine%laws(m)%law%lambda + 2.0_wp*engine%laws(m)%law%mu)
    end do
    associate (particles => engine%particles)
      !$omp parallel do schedule(static) private(c, f, history, tau, speed2)
      do g = 1, size(particles%groups)
        do c = particles%groups(g)%first, particles%groups(g)%last
          call chunk_deformation(particles, c, f)
          call chunk_history(particles, c, history)
          call engine%laws(particles%groups(g)%material)%law%kirchhoff(f, history, tau, speed2)
          frozen%stiffness(:, c) = particles%p(:, particles%mass%first, c)*speed2
        end do
      end do
      !$omp end parallel do
    end associate
    allocate (mass(1, nodes_per_block, engine%table%slots), none(1, 1, 1))
    allocate (frozen%per_mass(nodes_per_block, engine%table%slots), source=0.0_wp)
    call sweep(engine, frozen, give_mass, none, mass)
    call fold(engine, .false., mass)
    where (mass(1, :, :) > cutoff) frozen%per_mass = 1.0_wp/mass(1, :, :)
  end subroutine freeze

  !> Block Gershgorin: |K_ij| <= sum_p m c^2 |G_i||G_j|, so lambda <= max_i (1/m_i) sum_j |K_ij| and, scaled by the masses,
  !> <= max_i m_i^-1/2 sum_j |K_ij| m_j^-1/2, which light nodes spoil less. The smaller of the two.
  subroutine bound_rows(engine, frozen, lambda)
    type(engine_t), intent(inout) :: engine
    type(frozen_t), intent(in) :: frozen
    real(dp), intent(out) :: lambda !! bound of the eigenvalues of M^-1 K, times the squared spacing [m2/s2]
    real(wp), allocatable :: root(:, :, :), row(:, :, :)
    real(dp) :: largest(2)
    integer :: s
    allocate (root(1, nodes_per_block, engine%table%slots), row(2, nodes_per_block, engine%table%slots))
    root(1, :, :) = sqrt(frozen%per_mass)
    call share(engine, .false., root)
    call sweep(engine, frozen, give_rows, root, row)
    call fold(engine, .false., row)
    largest = 0.0_dp
    do s = 1, engine%table%slots
      if (.not. engine%table%booked(s)) cycle ! nodes of the others need not be complete here
      largest(1) = max(largest(1), real(maxval(row(1, :, s)*frozen%per_mass(:, s)), dp))
      largest(2) = max(largest(2), real(maxval(row(2, :, s)*root(1, :, s)), dp))
    end do
    call largest_reals(largest)
    lambda = minval(largest)
  end subroutine bound_rows

  !> Lanczos iteration on W M^-1 K, which is symmetric in the product x.K y (Parlett 1998, ch. 13)
  subroutine iterate(engine, walls, frozen, strains, lambda)
    type(engine_t), intent(inout) :: engine
    type(walls_t), intent(in) :: walls
    type(frozen_t), intent(in) :: frozen
    integer, intent(in) :: strains
    real(dp), intent(out) :: lambda !! largest eigenvalue times the squared spacing [m2/s2]
    real(wp), allocatable, dimension(:, :, :) :: q, before, next, kq, knext, work
    real(dp) :: alpha(most_lanczos), beta(0:most_lanczos), last
    integer :: k, n
    n = engine%table%slots
    allocate (q(3, nodes_per_block, n), kq(3, nodes_per_block, n), knext(3, nodes_per_block, n), work(3, nodes_per_block, n))
    allocate (before(3, nodes_per_block, n), source=0.0_wp)
    lambda = 0.0_dp
    call start_vector(engine, q)
    call obey(engine, walls, frozen, q)
    call stiffen(q, kq)
    call respond(kq, next) ! into the range of the operator
    call stiffen(next, knext)
    beta = 0.0_dp
    beta(0) = sqrt(max(0.0_dp, product_of(engine, next, knext)))
    if (.not. beta(0) > 0.0_dp) return
    do k = 1, most_lanczos
      q = real(1.0_dp/beta(k - 1), wp)*next
      kq = real(1.0_dp/beta(k - 1), wp)*knext
      call respond(kq, next)
      alpha(k) = product_of(engine, next, kq)
      next = next - real(alpha(k), wp)*q
      if (k > 1) next = next - real(beta(k - 1), wp)*before
      call stiffen(next, knext)
      beta(k) = sqrt(max(0.0_dp, product_of(engine, next, knext)))
      last = lambda
      lambda = largest_eigenvalue(alpha(:k), beta(1:k - 1))
      if (.not. beta(k) > 1.0e-6_dp*lambda) exit ! the vectors span all there is
      if (k > 4 .and. lambda - last < enough*lambda) exit
      before = q
    end do

  contains

    !> K x
    subroutine stiffen(x, kx)
      real(wp), intent(in) :: x(:, :, :)
      real(wp), intent(inout) :: kx(:, :, :)
      call sweep(engine, frozen, give_stiffness, x, kx)
      call fold(engine, .true., kx)
    end subroutine stiffen

    !> W M^-1 f, with what the sides hold left out
    subroutine respond(f, x)
      real(wp), intent(in) :: f(:, :, :)
      real(wp), allocatable, intent(inout) :: x(:, :, :)
      integer :: s, d
      if (.not. allocated(x)) allocate (x(3, nodes_per_block, n))
      do s = 1, n
        do d = 1, 3
          x(d, :, s) = f(d, :, s)*frozen%per_mass(:, s)
        end do
      end do
      call obey(engine, walls, frozen, x)
      if (strains == strains_plain) return
      call sweep(engine, frozen, give_smoothing, x, work)
      call fold(engine, .true., work)
      do s = 1, n
        do d = 1, 3
          work(d, :, s) = work(d, :, s)*frozen%per_mass(:, s)
        end do
      end do
      call obey(engine, walls, frozen, work)
      if (strains == strains_smoothed) then
        x = work
      else
        x = 2.0_wp*x - work
      end if
    end subroutine respond

  end subroutine iterate

  !> The largest eigenvalue of a symmetric tridiagonal matrix by bisection with Sturm's sequence
  pure real(dp) function largest_eigenvalue(diagonal, beside) result(value)
    real(dp), intent(in) :: diagonal(:), beside(:) !! (n), (n - 1)
    real(dp) :: low, high, d
    integer :: k, step
    low = maxval(diagonal)
    high = low + 2.0_dp*maxval([0.0_dp, abs(beside)])
    do step = 1, 60
      value = 0.5_dp*(low + high)
      d = diagonal(1) - value
      do k = 2, size(diagonal)
        if (d >= 0.0_dp) exit ! an eigenvalue at or above `value`
        d = diagonal(k) - value - beside(k - 1)**2/d
      end do
      if (d >= 0.0_dp) then
        low = value
      else
        high = value
      end if
    end do
    value = 0.5_dp*(low + high)
  end function largest_eigenvalue

  !> Numbers without a pattern that depend on the place of a node alone
  subroutine start_vector(engine, q)
    type(engine_t), intent(in) :: engine
    real(wp), intent(out) :: q(:, :, :)
    real(wp) :: x
    integer :: s, i, d, node(3)
    q = 0.0_wp
    do s = 1, engine%table%slots
      do i = 1, nodes_per_block
        node = node_at_place(engine%grid, engine%table%slot_at(:, s), i)
        do d = 1, engine%grid%dim
          x = 43758.5453_wp*sin(12.9898_wp*node(1) + 78.233_wp*node(2) + 37.719_wp*node(3) + d)
          q(d, i, s) = x - floor(x) - 0.5_wp
        end do
      end do
    end do
  end subroutine start_vector

  !> Sum of x y over all nodes, slot by slot. Collective
  real(dp) function product_of(engine, x, y)
    type(engine_t), intent(in) :: engine
    real(wp), intent(in) :: x(:, :, :), y(:, :, :)
    real(dp) :: part(size(x, 3))
    integer :: s
    !$omp parallel do schedule(static)
    do s = 1, size(x, 3)
      part(s) = 0.0_dp
      if (engine%table%booked(s)) part(s) = sum(real(x(:, :, s), dp)*y(:, :, s))
    end do
    !$omp end parallel do
    product_of = sum_of(part)
  end function product_of

  !> Leave out what the sides hold, and give images the values of the nodes they stand for
  subroutine obey(engine, walls, frozen, x)
    type(engine_t), intent(in) :: engine
    type(walls_t), intent(in) :: walls
    type(frozen_t), intent(in) :: frozen
    real(wp), intent(inout) :: x(:, :, :)
    real(wp) :: moved(3), free(3)
    integer :: s, i
    do s = 1, engine%table%slots
      if (.not. frozen%held(s)) cycle
      do i = 1, nodes_per_block
        free = x(:, i, s)
        call constrain(walls, engine%grid, node_at_place(engine%grid, engine%table%slot_at(:, s), i), free)
        moved = 0.0_wp ! of sides that move only the change counts
        call constrain(walls, engine%grid, node_at_place(engine%grid, engine%table%slot_at(:, s), i), moved)
        x(:, i, s) = free - moved
      end do
    end do
    call share(engine, .true., x)
  end subroutine obey

  !> Add what images were given to the nodes they stand for
  pure subroutine fold(engine, vector, x)
    type(engine_t), intent(in) :: engine
    logical, intent(in) :: vector !! mirrors turn the normal component around
    real(wp), intent(inout) :: x(:, :, :)
    integer :: k, n
    n = size(x, 1)
    if (.not. has_images(engine%grid)) return
    do k = 1, size(engine%images)
      associate (i => engine%images(k))
        x(:, i%target_place, i%target_slot) = x(:, i%target_place, i%target_slot) &
          + merge(i%sign(:n), 1.0_wp, vector)*x(:, i%place, i%slot)
        x(:, i%place, i%slot) = 0.0_wp
      end associate
    end do
  end subroutine fold

  !> Images take the values of the nodes they stand for
  pure subroutine share(engine, vector, x)
    type(engine_t), intent(in) :: engine
    logical, intent(in) :: vector
    real(wp), intent(inout) :: x(:, :, :)
    integer :: k, n
    n = size(x, 1)
    if (.not. has_images(engine%grid)) return
    do k = 1, size(engine%images)
      associate (i => engine%images(k))
        x(:, i%place, i%slot) = merge(i%sign(:n), 1.0_wp, vector)*x(:, i%target_place, i%target_slot)
      end associate
    end do
  end subroutine share

  !> Every particle gives to the nodes of its weight list; images are not folded yet. Collective
  subroutine sweep(engine, frozen, what, from, to)
    type(engine_t), intent(inout) :: engine
    type(frozen_t), intent(in) :: frozen
    integer, intent(in) :: what !! give_*
    real(wp), intent(in) :: from(:, :, :) !! what the particles take first
    real(wp), intent(inout) :: to(:, :, :)
    real(wp), allocatable :: wide(:, :), raw(:, :, :)
    logical :: whole(engine%table%blocks + engine%table%ghosts)
    integer :: b, slot
    call allot_spills(engine)
    !$omp parallel private(wide)
    allocate (wide(nf, wide_nodes(engine%grid%dim)), source=0.0_wp)
    !$omp do schedule(dynamic, 1)
    do b = 1, engine%table%blocks
      call sweep_block(engine, frozen, what, b, from, wide)
      engine%pad(:, :, b) = 0.0_wp
      call unload_wide(engine%grid, engine%table, b, pad_edge(engine%grid%dim, engine%basis), wide, engine%pad(:, :, b), &
                       engine%spilled(1 + omp_get_thread_num()))
    end do
    !$omp end do
    !$omp end parallel
    call order_spill(engine%spilled, engine%spill)
    call tell_signs(engine)
    call send_pads(engine, .true.)
    call complete_pads(engine, .true.)
    whole = .true.
    allocate (raw(nf, nodes_per_block, engine%table%slots))
    !$omp parallel do schedule(static) if(engine%table%slots > few_blocks)
    do slot = 1, engine%table%slots
      call sum_pads(engine, slot, raw(:, :, slot), whole)
    end do
    !$omp end parallel do
    call add_spills(engine, engine%table%slots, raw)
    to = raw(:size(to, 1), :, :)
  end subroutine sweep

  !> What the particles of a block give, by their nodes around the block
  subroutine sweep_block(engine, frozen, what, b, from, wide)
    type(engine_t), intent(in) :: engine
    type(frozen_t), intent(in) :: frozen
    integer, intent(in) :: what, b
    real(wp), intent(in) :: from(:, :, :)
    real(wp), intent(inout) :: wide(:, :)
    type(weight_list_t) :: list
    integer, allocatable :: slot(:), place(:), at(:)
    integer :: g, c, l, i, d, off(3)
    d = engine%grid%dim
    allocate (slot(size(list%s)), place(size(list%s)), at(size(list%s)))
    do g = engine%particles%block_group(b), engine%particles%block_group(b + 1) - 1
      do c = engine%particles%groups(g)%first, engine%particles%groups(g)%last
        do l = 1, lanes
          if (engine%particles%id(l, c) == 0) cycle
          call particle_list(engine, engine%table%block_at(:, b), c, l, list)
          do i = 1, list%n
            at(i) = wide_place(engine%grid, list%node(:, i))
            off = (list%node(:, i) - modulo(list%node(:, i), engine%grid%edge))/engine%grid%edge
            slot(i) = engine%table%slot_near(neighbour(off(1), off(2), off(3)), b)
            off = list%node(:, i) - off*engine%grid%edge
            place(i) = 1 + off(1) + engine%grid%edge(1)*(off(2) + engine%grid%edge(2)*off(3))
          end do
          select case (what)
          case (give_mass)
            do i = 1, list%n
              wide(1, at(i)) = wide(1, at(i)) + list%s(i)*engine%particles%p(l, engine%particles%mass%first, c)
            end do
          case (give_stiffness)
            call give_force(d, frozen%stiffness(l, c), frozen%bulk(engine%particles%groups(g)%material), list, slot, place, &
                            from, at, wide)
          case (give_smoothing)
            call give_value(engine%particles%p(l, engine%particles%mass%first, c), list, slot, place, from, at, wide)
          case (give_rows)
            call give_row(frozen%stiffness(l, c), list, slot, place, from, at, wide)
          end select
        end do
      end do
    end do
  end subroutine sweep_block

  !> f_i += k [lambda' tr(L) I + mu' (L + L^T)] G_i, L = sum_j u_j (x) G_j
  pure subroutine give_force(d, k, bulk, list, slot, place, u, at, f)
    integer, intent(in) :: d, slot(:), place(:), at(:) !! slots and places to take from, places around the block to give to
    real(wp), intent(in) :: k, bulk !! m c^2, lambda'
    type(weight_list_t), intent(in) :: list
    real(wp), intent(in) :: u(:, :, :)
    real(wp), intent(inout) :: f(:, :)
    real(wp) :: grad(3, 3), stress(3, 3), shear
    integer :: i, j
    grad = 0.0_wp
    do i = 1, list%n
      do j = 1, d
        grad(:, j) = grad(:, j) + u(:, place(i), slot(i))*list%g(j, i)
      end do
    end do
    shear = 0.5_wp*(1.0_wp - bulk)
    stress = k*shear*(grad + transpose(grad))
    do j = 1, 3
      stress(j, j) = stress(j, j) + k*bulk*(grad(1, 1) + grad(2, 2) + grad(3, 3))
    end do
    do i = 1, list%n
      do j = 1, d
        f(:d, at(i)) = f(:d, at(i)) + stress(:d, j)*list%g(j, i)
      end do
    end do
  end subroutine give_force

  !> f_i += m S_i sum_j S_j u_j
  pure subroutine give_value(mass, list, slot, place, u, at, f)
    real(wp), intent(in) :: mass
    type(weight_list_t), intent(in) :: list
    integer, intent(in) :: slot(:), place(:), at(:)
    real(wp), intent(in) :: u(:, :, :)
    real(wp), intent(inout) :: f(:, :)
    real(wp) :: v(3)
    integer :: i
    v = 0.0_wp
    do i = 1, list%n
      v = v + list%s(i)*u(:, place(i), slot(i))
    end do
    do i = 1, list%n
      f(:3, at(i)) = f(:3, at(i)) + mass*list%s(i)*v
    end do
  end subroutine give_value

  !> row_i += k |G_i| sum_j |G_j|, and the same with |G_j| m_j^-1/2
  pure subroutine give_row(k, list, slot, place, root, at, row)
    real(wp), intent(in) :: k
    type(weight_list_t), intent(in) :: list
    integer, intent(in) :: slot(:), place(:), at(:)
    real(wp), intent(in) :: root(:, :, :) !! m^-1/2
    real(wp), intent(inout) :: row(:, :)
    real(wp) :: length(list%n), total(2)
    integer :: i
    total = 0.0_wp
    do i = 1, list%n
      length(i) = norm2(list%g(:, i))
      total = total + length(i)*[1.0_wp, root(1, place(i), slot(i))]
    end do
    do i = 1, list%n
      row(:2, at(i)) = row(:2, at(i)) + k*length(i)*total
    end do
  end subroutine give_row

end module gimp_stability
