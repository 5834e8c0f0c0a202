!> What the transfers work on: grid, blocks, particles, pads and materials of one run, and what one pass over them does.
module gimp_engine
  use gimp_kinds, only: wp, dp, i8, lanes
  use gimp_grid, only: grid_t, nodes_per_block, fields_per_node
  use gimp_blocks, only: block_table_t
  use gimp_images, only: image_t
  use gimp_mesh, only: mesh_t
  use gimp_patches, only: patches_t
  use gimp_mesh_dual, only: smear_t
  use gimp_search, only: locator_t, rule_velocity
  use gimp_particles, only: particles_t, chunk_bytes, id_bytes
  use gimp_basis, only: basis_linear, support_width
  use gimp_point_domains, only: point_rule_t
  use gimp_border, only: border_t
  use gimp_material, only: material_t
  use gimp_storage, only: storage_t, reserve_storage, real_bytes
  use, intrinsic :: iso_c_binding, only: c_ptr, c_loc, c_f_pointer
  use omp_lib, only: omp_get_max_threads, omp_get_thread_num
  implicit none(type, external)
  private
  public :: anti_none, anti_f_bar, anti_b_bar, anti_cell_stress
  public :: engine_bytes, affine_none, affine_apic, affine_tpic, affine_mls
  public :: offer_tasks, take_task, order_blocks
  public :: engine_t, law_t, pass_t, spill_t, body_force_t, pad_nodes, pad_edge, drift, work_of_pad
  public :: least_spacing, allot_grid, clear_unused, borrow_pads, make_room, pad_bytes, grid_bytes
  public :: sum_kinetic, sum_external, sum_plastic, sum_clamped, sum_wide, sum_impulse, sum_affine, sum_detached, sum_handed, sum_handed_impulse, n_sums
  public :: sum_visits, sum_left, sum_by_velocity, sum_by_walk, sum_by_rings, sum_put_back, sum_beyond
  public :: leaving_stops, leaving_held, leaving_removes
  public :: peak_rate, peak_speed, peak_strain, n_peaks
  public :: sign_failed, sign_inside, sign_restless, sign_spills, sign_wide, n_signs
  public :: motion_none, motion_grid, motion_mean, motion_change
  public :: fate_fine, fate_inverted, fate_outside, fate_lost, fate_jumped, fate_far

  integer, parameter :: drift = 1 !! cells that a particle may stray from its block before it must be sorted

  integer, parameter :: tasks_per_thread = 32 !! handed out as threads become free
  integer, parameter :: apart = 16 !! counters of two threads must not share a cache line
  integer, parameter :: work_of_pad = 8 !! loading and storing the pad of a block, in chunks of particles

  !> What a pass makes of the velocity that particles move with (see `moved_by_particle`)
  integer, parameter :: motion_none = 0
  integer, parameter :: motion_grid = 1 !! S of fields 1-3
  integer, parameter :: motion_mean = 2 !! (v + v')/2
  integer, parameter :: motion_change = 3 !! (v' - v)/2 more than it was

  integer, parameter :: affine_none = 0, affine_apic = 1, affine_tpic = 2, affine_mls = 3
  integer, parameter :: anti_none = 0, anti_f_bar = 1, anti_b_bar = 2, anti_cell_stress = 3 !! remedies against locking

  !> Sums of a block over one pass, added exactly afterwards
  integer, parameter :: sum_kinetic = 1, sum_external = 2, sum_plastic = 3, sum_clamped = 4, sum_wide = 5, &
    sum_impulse = 6, sum_affine = 9, sum_detached = 10, sum_handed = 11, sum_handed_impulse = 12
  !! 6-8: impulse of the forces on particles; 9: energy of their affine part; 11-12: particles whose nodes handed on force, and the
  !! impulse of that
  !> Of meshes: elements tested beyond the own one, particles that left their element, those found by the velocity, by the walk and by
  !> rings or buckets; particles put back onto a side; points of domains beyond the mesh
  integer, parameter :: sum_visits = 13, sum_left = 14, sum_by_velocity = 15, sum_by_walk = 16, sum_by_rings = 17, sum_put_back = 18, &
    sum_beyond = 19, n_sums = 19
  !> Largest values of a block over one pass
  integer, parameter :: peak_rate = 1 !! square of wave speed plus particle speed [m2/s2]
  integer, parameter :: peak_speed = 2 !! squared particle speed [m2/s2]
  integer, parameter :: peak_strain = 3 !! squared norm of the velocity gradient [1/s2]
  integer, parameter :: n_peaks = 3
  !> What a pass tells of all blocks of all ranks, after the peaks: 1 if it is so anywhere
  integer, parameter :: sign_failed = 4 !! a particle went wrong
  integer, parameter :: sign_inside = 5 !! and not by leaving the grid
  integer, parameter :: sign_restless = 6 !! a particle nears the end of its pad
  integer, parameter :: sign_spills = 7 !! something was given beyond pads
  integer, parameter :: sign_wide = 8 !! supports too wide for the fast kernels
  integer, parameter :: n_signs = 8
  !> What became of the worst particle of a block
  integer, parameter :: fate_fine = 0, fate_inverted = 1, fate_outside = 2, fate_lost = 3, fate_jumped = 4, fate_far = 5

  !> What happens to a particle beyond a boundary side of a mesh
  integer, parameter :: leaving_stops = 0 !! the run ends
  integer, parameter :: leaving_held = 1 !! it is put back onto the side
  integer, parameter :: leaving_removes = 2 !! it is taken out

  !> A constitutive law of any kind
  type :: law_t
    class(material_t), allocatable :: law
  end type law_t

  !> A force per mass that depends on the reference position of a particle and on time
  type, abstract :: body_force_t
  contains
    procedure(evaluate_i), deferred :: evaluate
  end type body_force_t

  abstract interface
    !> Body force of the lanes of a chunk
    pure subroutine evaluate_i(self, t, x, b)
      import :: body_force_t, wp, dp, lanes
      implicit none(type, external)
      class(body_force_t), intent(in) :: self
      real(dp), intent(in) :: t !! time [s]
      real(wp), intent(in) :: x(lanes, 3) !! reference position from the corner of the box [cells]
      real(wp), intent(out) :: b(lanes, 3) !! [m/s2]
    end subroutine evaluate_i
  end interface

  !> What particles give to nodes beyond the pad of their block, in the order of slots, then blocks
  type :: spill_t
    integer :: n = 0
    integer, allocatable :: block(:), slot(:), place(:)
    real(wp), allocatable :: value(:, :) !! (field, entry)
  end type spill_t

  !> One pass over the particles. What is taken from the grid (fields 1-3: a velocity, 5-7: its change in the step) comes
  !> first, what is given to it (momentum, mass, force, energy) second.
  type :: pass_t
    logical :: velocity = .false. !! v' = S v+ + q (v - S v)
    logical :: position = .false. !! x' = x + dt S v+
    logical :: strain = .false. !! L = grad of fields 1-3; F and the state of the material follow
    logical :: moved_by_second = .false. !! S v+ for the position stands in fields 5-7 (second pass of MUSL)
    logical :: momentum = .false. !! give mass, momentum and kinetic energy
    logical :: force = .false. !! give internal and body forces
    logical :: redistribute = .false. !! light nodes, marked in the grid, hand on the force that is given
    logical :: old_weights = .false. !! give with the weights of the take
    logical :: stress_give = .false. !! only give the stress, to be averaged at the nodes (see gimp_smoothed_stress)
    logical :: stress_take = .false. !! only take that average
    logical :: cells = .false. !! only add up over the cells what the strains of the next pass need (see gimp_cells)
    logical :: smooth = .false. !! give m S u as momentum, u of fields 1-3; particles stay as they are
    logical :: external = .false. !! book the work of external forces, though no velocity is new
    integer :: replaced_by = 0 !! v' = S of the velocity from this field on (1 or 5), in place of the formula above
    logical :: moved_by_particle = .false. !! x' = x + dt V, V the particle's `motion` if it has one, else its new velocity
    integer :: motion = motion_none
    logical :: acceleration = .false. !! a' = S of fields 1-3, kept by the particle
    logical :: own_kick = .false. !! v' = v + kick a' with the acceleration that the particle keeps
    logical :: inertia = .false. !! give mass times that acceleration in the place of forces
    real(wp) :: dt = 0.0_wp !! step of positions [s]
    real(wp) :: dt_strain = 0.0_wp !! step of strains [s]
    real(wp) :: kick = 0.0_wp !! step of velocities [s]: the half-step start and changing steps make it differ
    real(wp) :: flip = 1.0_wp !! q: 1 FLIP, 0 PIC
    real(wp) :: back = 0.5_wp !! share of fields 5-7 that leads from fields 1-3 back to the velocity with which forces do work
    real(dp) :: time = 0.0_dp !! at which given forces act [s]
  end type pass_t

  !> All that a run steps forward
  type :: engine_t
    type(grid_t) :: grid
    type(block_table_t) :: table
    type(image_t), allocatable :: images(:)
    type(mesh_t) :: mesh !! in place of the grid's cells, if grid%is_mesh
    type(patches_t) :: patches !! its blocks
    type(locator_t) :: locator
    type(smear_t) :: smear !! smeared gradients of its nodes, with basis = ddmp
    integer :: search_rule = rule_velocity
    integer, allocatable :: leaving(:) !! (boundary side of the mesh) what happens to particles beyond it
    integer, allocatable :: pad_place(:, :) !! (node, thread) place of a node in the pad that the thread works on; elsewhere anything
    type(particles_t) :: particles
    type(law_t), allocatable :: laws(:) !! by material
    class(body_force_t), allocatable :: body_force
    integer :: basis = basis_linear
    logical :: domain_volume = .false. !! forces take the volume of the domain in place of that of the material
    logical :: total_deformation = .false. !! F from the corners of the domain, F = sum x_a (x) g_a of the reference shape
    integer :: domain_rule = 0 !! how domains follow the deformation; 0: they do not
    type(point_rule_t) :: rule !! of a basis that samples its domains
    real(wp) :: overlap = 1.0_wp !! factor on the initial half lengths of domains, for the weights
    real(wp) :: longest_diagonal = 1.0_wp !! of such a domain [cells]; longer ones are scaled
    real(wp) :: dual_alpha = 0.5_wp !! alpha_max of the dual domain method
    integer :: affine = affine_none !! affine part of the velocity transfer
    logical :: total = .false. !! total Lagrangian: weights are those of the start, and so are gradients
    integer :: anti_locking = anti_none
    integer :: f_update = 1 !! 1 Cayley, 2 forward, 3 exponential
    logical :: list_kernel = .false. !! walk weight lists everywhere
    real(wp), pointer, contiguous :: g(:, :, :) => null() !! (field, node of block, slot)
    real(wp), pointer, contiguous :: pad(:, :, :) => null() !! (field, node of pad, block)
    real(wp), allocatable :: cell_sum(:, :, :) !! (number, cell of block, slot) of what particles gave to their cells
    real(wp), allocatable :: smoothed(:, :, :) !! (lane, component, chunk) stress averaged at the nodes, while a frame is made [Pa]
    logical, allocatable :: drifted(:) !! (block) the outer layer of its pad is in use
    integer, allocatable :: order(:) !! blocks in the order of work: first those whose pads go to other ranks
    integer :: at_border = 0 !! how many these are
    integer, allocatable :: task(:) !! (tasks + 1) where each task of a pass begins in `order`
    integer, allocatable :: taken(:, :) !! (apart, thread) tasks of its share that are taken
    type(spill_t) :: spill
    type(spill_t), allocatable :: spilled(:) !! (thread) as blocks leave it, before it is brought into order
    real(dp), allocatable :: sums(:, :) !! (n_sums, block)
    real(wp), allocatable :: peaks(:, :) !! (n_peaks, block)
    integer, allocatable :: fate(:, :) !! (3, block): what, chunk, lane
    logical, allocatable :: restless(:) !! (block) a particle nears the end of the pad: sort soon
    real(wp) :: allowed_low(3) = -huge(1.0_wp), allowed_high(3) = huge(1.0_wp) !! particles must stay between [cells]
    type(border_t) :: border !! what this rank knows of others
    real(dp) :: all_sums(n_sums) = 0.0_dp !! of `sums` over all blocks of all ranks, after a pass
    real(dp) :: told(n_signs) = 0.0_dp !! by the last pass, of all ranks: largest of the peaks, then signs
    type(storage_t), private :: pad_store, grid_store
  end type engine_t

contains

  !> Edge of a cell, or the least height of an element, as time steps see it [m]
  pure real(dp) function least_spacing(engine)
    type(engine_t), intent(in) :: engine
    least_spacing = engine%grid%spacing
    if (engine%grid%is_mesh) least_spacing = least_spacing*minval(engine%patches%height)
  end function least_spacing

  !> Nodes along each axis of the pad of a block: its own, the support beyond, and one cell of drift on both sides
  pure function pad_edge(dim, basis) result(n)
    integer, intent(in) :: dim, basis
    integer :: n(3)
    n = 1
    select case (dim)
    case (1); n(1) = 64 + support_width(basis) - 1 + 2*drift
    case (2); n(1:2) = 8 + support_width(basis) - 1 + 2*drift
    case (3); n = 4 + support_width(basis) - 1 + 2*drift
    end select
  end function pad_edge

  !> Nodes of a pad
  pure integer function pad_nodes(dim, basis)
    integer, intent(in) :: dim, basis
    pad_nodes = product(pad_edge(dim, basis))
  end function pad_nodes

  !> Bytes in use: particles, pads (whose memory also serves the sort) and grid
  pure integer(i8) function engine_bytes(engine)
    type(engine_t), intent(in) :: engine
    engine_bytes = chunk_bytes(engine%particles%components, engine%particles%chunks) + id_bytes(engine%particles%chunks) &
                   + engine%pad_store%bytes + engine%grid_store%bytes
    if (allocated(engine%cell_sum)) engine_bytes = engine_bytes + grid_bytes(size(engine%cell_sum, 3))
  end function engine_bytes

  !> Bytes of the pads of so many blocks
  pure integer(i8) function pad_bytes(dim, basis, blocks)
    integer, intent(in) :: dim, basis, blocks
    pad_bytes = real_bytes*fields_per_node*pad_nodes(dim, basis)*blocks
  end function pad_bytes

  !> Bytes of so many slots of the grid
  pure integer(i8) function grid_bytes(slots)
    integer, intent(in) :: slots
    grid_bytes = real_bytes*fields_per_node*nodes_per_block*slots
  end function grid_bytes

  !> The memory of the pads, which are empty during a sort, for two lists; `allot_grid` takes it back
  subroutine borrow_pads(engine, bytes, first, second)
    type(engine_t), intent(inout) :: engine
    integer(i8), intent(in) :: bytes(2) !! of each list
    type(c_ptr), intent(out) :: first, second !! on cache lines
    integer(i8) :: start
    character, pointer :: memory(:)
    start = (bytes(1) + 63)/64*64
    engine%pad => null()
    call reserve_storage(engine%pad_store, start + bytes(2))
    first = engine%pad_store%address
    call c_f_pointer(first, memory, [start + 1])
    second = c_loc(memory(start + 1))
  end subroutine borrow_pads

  !> Room for the grid and the pads of the blocks that are active now. Their memory is first touched by the threads that work on
  !> it: nothing is written here.
  subroutine allot_grid(engine)
    type(engine_t), intent(inout) :: engine
    integer :: n
    associate (table => engine%table)
      n = pad_nodes(engine%grid%dim, engine%basis)
      if (engine%grid%is_mesh) n = engine%patches%most_pad
      call reserve_storage(engine%pad_store, real_bytes*fields_per_node*n*(table%blocks + table%ghosts))
      call c_f_pointer(engine%pad_store%address, engine%pad, [fields_per_node, n, table%blocks + table%ghosts])
      engine%pad(:, :, table%blocks + 1:) = 0.0_wp ! parts of them are never sent
      call reserve_storage(engine%grid_store, grid_bytes(table%slots))
      call c_f_pointer(engine%grid_store%address, engine%g, [fields_per_node, nodes_per_block, table%slots])
      if (allocated(engine%drifted)) deallocate (engine%drifted, engine%sums, engine%peaks, engine%fate, engine%restless)
      allocate (engine%drifted(table%blocks + table%ghosts), source=.true.)
      allocate (engine%restless(table%blocks), source=.false.)
      allocate (engine%sums(n_sums, table%blocks), source=0.0_dp)
      allocate (engine%peaks(n_peaks, table%blocks), source=0.0_wp)
      allocate (engine%fate(3, table%blocks), source=0)
    end associate
    if (engine%anti_locking /= anti_none) then
      if (allocated(engine%cell_sum)) deallocate (engine%cell_sum)
      allocate (engine%cell_sum(fields_per_node, nodes_per_block, engine%table%slots), source=0.0_wp)
    end if
    engine%spill%n = 0
    if (.not. allocated(engine%spill%slot)) call make_room(engine%spill, 64)
    if (allocated(engine%taken)) deallocate (engine%taken)
    if (engine%grid%is_mesh .and. .not. allocated(engine%pad_place)) then
      allocate (engine%pad_place(engine%mesh%nodes, omp_get_max_threads()), source=1)
    end if
    call order_blocks(engine)
  end subroutine allot_grid

  !> Zeros in the nodes of a block's pad that are not in use: without drift the outermost ones
  pure subroutine clear_unused(engine, block, pad)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: block
    real(wp), intent(inout) :: pad(:, :) !! (field, node)
    integer :: edge(3), node(3), i, used
    if (engine%grid%is_mesh) then
      associate (patch => engine%table%block_at(1, block))
        used = merge(engine%patches%pad_first(patch + 1) - engine%patches%pad_first(patch), engine%patches%inner(patch), engine%drifted(block))
      end associate
      pad(:, used + 1:) = 0.0_wp
    else if (.not. engine%drifted(block)) then
      edge = pad_edge(engine%grid%dim, engine%basis)
      do i = 1, size(pad, 2)
        node = [modulo(i - 1, edge(1)), modulo((i - 1)/edge(1), edge(2)), (i - 1)/(edge(1)*edge(2))]
        if (any(edge > 1 .and. (node == 0 .or. node == edge - 1))) pad(:, i) = 0.0_wp
      end do
    end if
  end subroutine clear_unused

  !> Blocks whose pads go to other ranks are worked on first, so that messages travel while the others are
  pure subroutine order_blocks(engine)
    type(engine_t), intent(inout) :: engine
    logical :: sends(engine%table%blocks)
    integer :: b
    sends = .false.
    if (allocated(engine%border%give%block)) sends(engine%border%give%block) = .true.
    engine%order = [pack([(b, b=1, engine%table%blocks)], sends), pack([(b, b=1, engine%table%blocks)], .not. sends)]
    engine%at_border = count(sends)
  end subroutine order_blocks

  !> Tasks for the blocks from `first` to `last` in their order of work; each thread has an equal share of them to itself
  subroutine offer_tasks(engine, first, last)
    type(engine_t), intent(inout) :: engine
    integer, intent(in) :: first, last
    call cut_tasks(engine%particles, engine%order, first, last, tasks_per_thread*omp_get_max_threads(), engine%task)
    if (.not. allocated(engine%taken)) allocate (engine%taken(apart, tasks_of(engine)/tasks_per_thread))
    engine%taken = 0
  end subroutine offer_tasks

  !> The next task of the calling thread: one of its own share, whose particles and pads lie in memory near it, or one that another
  !> thread has not come to; 0 when none is left. Who works on a block decides nothing about results.
  subroutine take_task(engine, task)
    type(engine_t), intent(inout) :: engine
    integer, intent(out) :: task
    integer :: k, share, n
    do k = 0, size(engine%taken, 2) - 1
      share = 1 + modulo(omp_get_thread_num() + k, size(engine%taken, 2))
      !$omp atomic capture
      engine%taken(1, share) = engine%taken(1, share) + 1
      n = engine%taken(1, share)
      !$omp end atomic
      task = tasks_per_thread*(share - 1) + n
      if (n <= tasks_per_thread) return
    end do
    task = 0
  end subroutine take_task

  pure integer function tasks_of(engine)
    type(engine_t), intent(in) :: engine
    tasks_of = size(engine%task) - 1
  end function tasks_of

  !> Cut consecutive blocks of the order into tasks of about equal work, counted in chunks; the pads of a block cost like a few chunks
  pure subroutine cut_tasks(particles, order, first, last, tasks, task)
    type(particles_t), intent(in) :: particles
    integer, intent(in) :: order(:), first, last, tasks
    integer, allocatable, intent(inout) :: task(:) !! (tasks + 1) where each begins in the order
    integer(i8) :: done, all_work
    integer :: i, k
    if (allocated(task)) then
      if (size(task) /= tasks + 1) deallocate (task)
    end if
    if (.not. allocated(task)) allocate (task(tasks + 1))
    all_work = 0
    do i = first, last
      all_work = all_work + work_of(order(i))
    end do
    done = 0
    k = 1
    task(1) = first
    do i = first, last
      do while (k < tasks .and. done*tasks >= k*all_work)
        k = k + 1
        task(k) = i
      end do
      done = done + work_of(order(i))
    end do
    task(k + 1:) = last + 1

  contains

    pure integer function work_of(b)
      integer, intent(in) :: b
      work_of = work_of_pad + particles%groups(particles%block_group(b + 1) - 1)%last &
                - particles%groups(particles%block_group(b))%first + 1
    end function work_of

  end subroutine cut_tasks

  !> Room for so many entries of the spill list; those there are kept
  pure subroutine make_room(spill, entries)
    type(spill_t), intent(inout) :: spill
    integer, intent(in) :: entries
    type(spill_t) :: wider
    if (allocated(spill%slot)) then
      if (size(spill%slot) >= entries) return
    end if
    allocate (wider%block(entries), wider%slot(entries), wider%place(entries), wider%value(fields_per_node, entries))
    wider%n = spill%n
    if (spill%n > 0) then
      wider%block(:spill%n) = spill%block(:spill%n)
      wider%slot(:spill%n) = spill%slot(:spill%n)
      wider%place(:spill%n) = spill%place(:spill%n)
      wider%value(:, :spill%n) = spill%value(:, :spill%n)
    end if
    spill = wider
  end subroutine make_room

end module gimp_engine
