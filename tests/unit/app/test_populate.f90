!> Particles that ranks make together are those that one makes alone: same numbers, same bits of every field, same words about
!> mistakes. Alone the suite writes down what it found; on ranks it compares.
program test_populate
  use gimp_kinds, only: dp, i8, lanes
  use gimp_error, only: error_t
  use gimp_text, only: text_of
  use gimp_hash_table, only: mix_bits
  use gimp_ranks, only: this_rank, ranks, backend, start_ranks, end_ranks
  use gimp_over_ranks, only: sum_counts, any_rank
  use gimp_scene, only: scene_t, parse_scene
  use gimp_run_state, only: stepper_t
  use gimp_verification, only: verification_t
  use gimp_setup, only: set_up_scene
  use gimp_population, only: population_t, count_particles
  use gimp_populate, only: populate
  use gimp_measures, only: nearest_particle, measure_probes, probe_values
  use gimp_particle_file, only: particle_table_t, write_particle_file
  use gimp_check, only: begin_suite, suite_failed, check, check_true
  implicit none(type, external)
  character(len=1), parameter :: nl = new_line("a")
  character(len=*), parameter :: rubber = '&material name = "rubber" model = "neo_hookean" density = 1000.0 young_modulus = 1.0e4 ' &
    //'poisson_ratio = 0.3 /'//nl
  character(len=*), parameter :: soil = '&material name = "soil" model = "drucker_prager" density = 2000 young_modulus = 1e7 ' &
    //'poisson_ratio = .25 friction_angle = 30 /'//nl
  character(len=*), parameter :: plane = '&scene dimension = 2 /'//nl//'&grid lower = 0.0, 0.0 upper = 2.0, 2.0 spacing = 0.1 /'//nl
  character(len=*), parameter :: space = '&scene dimension = 3 /'//nl//'&grid lower = 0.0, 0.0, 0.0 upper = 1.0, 1.0, 1.0 ' &
    //'spacing = 0.1 /'//nl
  character(len=*), parameter :: end = nl//'&time end = 0.1 /'//nl//'&output name = "populate" /'//nl
  character(len=*), parameter :: ring = '&body name = "ring" material = "rubber" shape = "ring" center = 1.0, 1.0 inner_radius = 0.5' &
    //' outer_radius = 0.9 fill = "polar" radial_particles = 7 angular_particles = 60 angular_velocity = 2.0 /'//nl
  character(len=*), parameter :: file = '&body name = "file" material = "soil" shape = "file" file = "populate.h5" /'//nl
  integer :: unit

  call start_ranks()
  call begin_suite("populate, "//trim(backend)//", "//text_of(this_rank)//" of "//text_of(ranks))
  if (ranks == 1) then
    call write_file()
    open (newunit=unit, file="populate.txt", status="replace", action="write")
  else
    open (newunit=unit, file="populate.txt", status="old", action="read")
  end if
  call several_bodies()
  call domains()
  call few()
  call mistakes()
  close (unit)
  call end_ranks(merge(1, 0, any_rank(suite_failed())))

contains

  !> 50 particles. The last of `populate_far.h5` is outside the grid, `populate_bad.h5` has faults in its second half; in
  !> `populate_wide.h5` the domain of particle 40 is wide, and from 30 on they are deformed.
  subroutine write_file()
    type(particle_table_t) :: table
    type(error_t), allocatable :: error
    integer :: k
    table%position = reshape([(0.2_dp + 0.003_dp*k, 1.5_dp + 0.1_dp*sin(1.0_dp*k), k=1, 50)], [2, 50])
    table%volume = [(1.0e-3_dp + 1.0e-6_dp*k, k=1, 50)]
    table%mass = 2000.0_dp*table%volume
    table%stress = reshape([(-1.0e3_dp*k, -2.0e3_dp, -1.5e3_dp, 10.0_dp*k, 0.0_dp, 0.0_dp, k=1, 50)], [6, 50])
    call write_particle_file("populate.h5", table, error)
    call check_true(.not. allocated(error), "particle file")
    allocate (table%half_length(2, 50), source=0.01_dp)
    allocate (table%deformation_gradient(4, 50), source=0.0_dp)
    table%deformation_gradient(1, :) = 1.0_dp
    table%deformation_gradient(4, :) = 1.0_dp
    table%deformation_gradient(2, 30:) = 0.1_dp
    table%half_length(2, 40) = 0.3_dp
    call write_particle_file("populate_wide.h5", table, error)
    deallocate (table%half_length, table%deformation_gradient)
    table%position(2, 50) = 3.0_dp
    call write_particle_file("populate_far.h5", table, error)
    table%mass(30) = -1.0_dp
    table%volume(45) = 0.0_dp
    call write_particle_file("populate_bad.h5", table, error)
  end subroutine write_file

  !> Two materials, a hole, loads on faces, velocities, a file between bodies with a shape
  subroutine several_bodies()
    character(len=*), parameter :: bodies = '&body name = "wall" material = "soil" shape = "box" lower = 0.0, 0.0 upper = 0.1, 1.2 /'//nl &
      //file//'&body name = "ball" material = "rubber" shape = "sphere" center = 1.0, 0.7 radius = 0.45 particles_per_axis = 3 ' &
      //'velocity = 0.1, -0.2 angular_velocity = 3.0 /'//nl &
      //'&body name = "hole" operation = "subtract" shape = "sphere" center = 1.1, 0.7 radius = 0.2 /'//nl &
      //'&body name = "rest" material = "rubber" shape = "box" lower = 0.8, 0.6 upper = 1.6, 1.0 /'//nl
    call compare("several bodies", plane//rubber//soil//bodies &
      //'&load kind = "traction" body = "ball" face = "all" traction = 0.0, 1.0 /'//nl//'&method basis = "cpgimp" /'//end)
    call compare("points", plane//rubber//soil//bodies//'&method basis = "linear" /'//end)
    call compare("equal particles", space//rubber//'&body name = "ball" material = "rubber" shape = "sphere" center = 3*0.5 radius = 0.4' &
      //' deformation_gradient = 1.0, 0.1, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.1 /'//nl//'&method basis = "cpdi" /'//end)
    call compare("exact start", '&scene dimension = 2 /'//nl//'&grid lower = 0.0, 0.0 upper = 1.0, 1.0 spacing = 0.0625 /'//nl//rubber &
      //'&body name = "block" material = "rubber" shape = "box" lower = 0.0, 0.0 upper = 1.0, 1.0 initial = "verification" /'//nl &
      //'&boundary side = "all" condition = "slip" /'//nl//'&method basis = "cpgimp" /'//nl &
      //'&verification solution = "axis_aligned" amplitude = 0.05 /'//end)
  end subroutine several_bodies

  !> Domains of all kinds, and corners that move with the grid
  subroutine domains()
    call compare("polar", plane//rubber//ring//'&method basis = "cpgimp" /'//end)
    call compare("sectors", plane//rubber//ring//'&method basis = "cpdi2" /'//end)
    call compare("triangles", plane//rubber//ring//'&body name = "box" material = "rubber" shape = "box" lower = 0.0, 0.0 ' &
      //'upper = 0.3, 0.25 /'//nl//'&method basis = "cpdi2" particle_domain = "simplex" /'//end)
    call compare("tetrahedra", space//rubber//'&body name = "ball" material = "rubber" shape = "sphere" center = 3*0.5 radius = 0.3 ' &
      //'particles_per_axis = 1 /'//nl//'&method basis = "cpdi2" particle_domain = "simplex" stress_update = "usl" cpdi2_deformation = "total" /'//end)
  end subroutine domains

  !> Fewer particles than ranks
  subroutine few()
    call compare("two particles", plane//rubber//'&body name = "left" material = "rubber" shape = "box" lower = 0.1, 0.1 upper = 0.2, 0.2 ' &
      //'particles_per_axis = 1 velocity = 1.0, 2.0 /'//nl//'&body name = "right" material = "rubber" shape = "box" ' &
      //'lower = 1.1, 0.1 upper = 1.2, 0.2 particles_per_axis = 1 /'//nl//'&method basis = "ugimp" /'//end)
  end subroutine few

  subroutine mistakes()
    character(len=*), parameter :: box = '&body name = "box" material = "rubber" shape = "box" lower = 0.1, 0.1 '
    call compare("outside", plane//rubber//box//'upper = 2.2, 0.5 /'//nl &
      //'&body name = "in" material = "rubber" shape = "box" lower = 0.2, 0.2 upper = 0.3, 0.3 /'//end)
    call compare("faults in a file", plane//rubber//soil//box//'upper = 2.2, 0.5 /'//nl &
      //'&body name = "bad" material = "soil" shape = "file" file = "populate_bad.h5" /'//end)
    call compare("last outside", plane//soil//'&body name = "far" material = "soil" shape = "file" file = "populate_far.h5" /'//end)
    call compare("wide domains", plane//rubber//soil//box//'upper = 0.3, 0.3 /'//nl &
      //'&body name = "wide" material = "soil" shape = "file" file = "populate_wide.h5" /'//nl//'&method basis = "ugimp" /'//end)
    call compare("deformed start", plane//rubber//soil//box//'upper = 0.5, 0.5 /'//nl &
      //'&body name = "wide" material = "soil" shape = "file" file = "populate_wide.h5" /'//nl &
      //'&method basis = "cpgimp" formulation = "total" /'//end)
  end subroutine mistakes

  !> What one rank says about a scene is what several say
  subroutine compare(what, text)
    character(len=*), intent(in) :: what, text
    character(len=:), allocatable :: words
    character(len=2000) :: expected
    call describe(what, text, words)
    if (ranks == 1) then
      write (unit, "(a)") words
    else
      read (unit, "(a)") expected
      call check(words, trim(expected), what)
    end if
  end subroutine compare

  !> Mistakes, or hashes of the particles of a scene; one line
  subroutine describe(what, text, words)
    character(len=*), intent(in) :: what, text
    character(len=:), allocatable, intent(out) :: words
    type(scene_t) :: scene
    type(stepper_t), allocatable :: s ! on the heap: it is large
    type(verification_t) :: solution
    type(population_t) :: population
    type(error_t), allocatable :: error
    real(dp), allocatable :: probe(:, :)
    integer(i8) :: hash, numbers, id(2)
    integer :: k
    allocate (s)
    call parse_scene(text, scene, error)
    if (.not. allocated(error)) call set_up_scene(scene, s, solution, error)
    if (allocated(error)) then
      call check_true(.false., what//": "//error%message)
      words = ""
      return
    end if
    call count_particles(scene, s, population, error)
    if (.not. allocated(error)) call populate(scene, s, solution, population, error)
    words = what//": "
    if (allocated(error)) then
      do k = 1, len(error%message) ! in one line
        words = words//merge("|", error%message(k:k), error%message(k:k) == nl)
      end do
      return
    end if
    call add_hashes(s, hash, numbers)
    call check_true(s%engine%particles%n_all == sum_counts(s%engine%particles%n), what//": all particles are made")
    call check_true(numbers == s%engine%particles%n_all*(s%engine%particles%n_all + 1)/2, what//": every number is there")
    if (s%engine%particles%n_all > 200) call check_true(s%engine%particles%n < 2*s%engine%particles%n_all/ranks + 100, &
      what//": no rank has many more than its share")
    id(1) = nearest_particle(s%engine, [0.9_dp, 0.7_dp, 0.5_dp], 1_i8, huge(1_i8))
    id(2) = nearest_particle(s%engine, [0.9_dp, 0.7_dp, 0.5_dp], 1_i8, 2_i8)
    allocate (probe(probe_values(scene%dimension), 2))
    call measure_probes(s%engine, id, probe)
    words = words//text_of(s%engine%particles%n_all)//" particles, "//text_of(s%engine%particles%components)//" values, hash " &
            //text_of(hash)//", particles "//text_of(id(1))//" and "//text_of(id(2))//" near a point, "//text_of(hash_of(probe))
    do k = 1, 3
      words = words//" "//text_of(transfer(real(s%engine%particles%uniform_half(k), dp), 1_i8))
    end do
    call check_true(nearest_particle(s%engine, [0.9_dp, 0.7_dp, 0.5_dp], huge(1_i8), huge(1_i8)) == 0, what//": none is no particle")
  end subroutine describe

  !> Sums over all particles: of hashes of number, material and fields, and of numbers
  subroutine add_hashes(s, hash, numbers)
    type(stepper_t), intent(in) :: s
    integer(i8), intent(out) :: hash, numbers
    integer(i8) :: h
    integer :: g, c, l, f
    hash = 0
    numbers = 0
    associate (particles => s%engine%particles)
      do g = 1, size(particles%groups)
        do c = particles%groups(g)%first, particles%groups(g)%last
          do l = 1, lanes
            if (particles%id(l, c) == 0) cycle
            h = mix_bits(ieor(mix_bits(particles%id(l, c)), int(particles%groups(g)%material, i8)))
            do f = 1, particles%components
              h = mix_bits(ieor(h, transfer(real(particles%p(l, f, c), dp), 0_i8)))
            end do
            hash = hash + iand(h, 2_i8**40 - 1)
            numbers = numbers + particles%id(l, c)
          end do
        end do
      end do
    end associate
    hash = sum_counts(hash)
    numbers = sum_counts(numbers)
  end subroutine add_hashes

  pure integer(i8) function hash_of(values) result(h)
    real(dp), intent(in) :: values(:, :)
    integer :: i, j
    h = 0
    do j = 1, size(values, 2)
      do i = 1, size(values, 1)
        h = mix_bits(ieor(h, transfer(values(i, j), 0_i8)))
      end do
    end do
  end function hash_of

end program test_populate
