!> Who the particles of a run are: shapes are counted, particle files read and looked through, and numbers given.
!>
!> Each rank makes a share of the particles of each body. Numbers are those of one rank alone: body by body, within a body in the
!> order of the fill or of the file.
module gimp_population
  use gimp_kinds, only: wp, dp, i8
  use gimp_error, only: error_t, add_error, raise
  use gimp_text, only: text_of
  use gimp_shapes, only: shape_none, shape_box, shape_sphere, shape_cylinder, shape_ring, shape_polygon, shape_region, &
    shape_center
  use gimp_shares, only: share_t
  use gimp_ranks, only: this_rank, ranks, sum_words, words_before
  use gimp_over_ranks, only: share_error
  use gimp_fill, only: fill_t, fill_body_t, count_share, check_counts, fill_share
  use gimp_particle_file, only: particle_table_t, read_particle_file
  use gimp_corner_domains, only: carried_none, carried_box, carried_simplex
  use gimp_run_state, only: stepper_t
  use gimp_element_region, only: element_region_t, make_element_region, kind_is_simplex
  use gimp_start_corners, only: table_corner_fault
  use gimp_setup_sides, only: place_of, name_advice
  use gimp_scene, only: scene_t, count_groups, is_given, real_of, reals_of, integers_of, integer_of, word_of, text_of_key, &
    complain
  implicit none(type, external)
  private
  public :: population_t, count_particles, determinant_of

  !> Where the particles of each body come from
  type :: population_t
    type(fill_t) :: fill !! bodies with a shape
    type(particle_table_t), allocatable :: table(:) !! (body) bodies from a file
    real(dp), allocatable :: center(:, :) !! (3, body) of its shape [m]
    integer(i8), allocatable :: first(:), count(:) !! (body) numbers of its particles, on all ranks
    integer(i8), allocatable :: from(:), here(:) !! (body) the same of those that this rank makes
    integer(i8) :: n = 0 !! particles of all ranks
  end type population_t

contains

  !> Fill the shapes and read the files; afterwards the number of particles is known. Collective
  subroutine count_particles(scene, s, population, error)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(in), target :: s
    type(population_t), intent(out) :: population
    type(error_t), allocatable, intent(out) :: error
    type(fill_body_t), allocatable :: bodies(:)
    type(element_region_t), allocatable, target :: region(:)
    type(error_t), allocatable :: problem
    type(share_t) :: mine
    integer(i8), allocatable :: count(:)
    integer, allocatable :: outside(:)
    integer :: b
    mine = share_t(this_rank, ranks)
    allocate (bodies(count_groups(scene, "body")), population%table(count_groups(scene, "body")))
    allocate (region(size(bodies)), population%center(3, size(bodies)))
    do b = 1, size(bodies)
      call describe_body(scene, b, bodies(b))
      if (bodies(b)%shape%kind == shape_region) call describe_region(scene, s, b, bodies(b), region(b), error)
      population%center(:, b) = shape_center(bodies(b)%shape, scene%dimension)
    end do
    if (allocated(error)) return
    bodies%corners = s%engine%rule%carried /= carried_none
    bodies%simplices = s%engine%rule%carried == carried_simplex
    associate (grid => s%engine%grid)
      call count_share(grid%dim, grid%lower, grid%spacing, grid%cells, bodies, mine, population%fill, outside, problem)
      if (.not. allocated(problem)) then
        call join_counts(population%fill%count, outside, count)
        call check_counts(grid%dim, grid%lower, grid%spacing, grid%cells, grid%is_mesh, bodies, count, outside, problem)
      end if
    end associate
    if (allocated(problem)) call tell_fill(scene, bodies, problem%message, error)
    do b = 1, size(bodies)
      if (word_of(scene, "body", b, "shape") /= "file") cycle
      call read_particle_file(text_of_key(scene, "body", b, "file"), scene%dimension, population%table(b), problem, mine)
      if (allocated(problem)) then
        call complain(error, scene, "body", b, "file", problem%message)
      else
        call check_table(scene, s, population%table(b), problem)
        call share_error(problem) ! the lowest rank has the lowest rows
        if (allocated(problem)) call complain(error, scene, "body", b, "file", problem%message)
      end if
    end do
    if (allocated(error)) return
    call number_particles(population)
    if (population%n == 0) call raise(error, "the scene holds no particle")
    if (allocated(error)) return
    associate (grid => s%engine%grid)
      call fill_share(grid%dim, grid%lower, grid%spacing, grid%cells, bodies, population%fill)
    end associate
  end subroutine count_particles

  !> What all ranks counted, and the sides where any of them saw a body stick out. Collective
  subroutine join_counts(here, outside, count)
    integer(i8), intent(in) :: here(:) !! (body) particles of this rank
    integer, intent(inout) :: outside(:) !! (body) bit masks, of this rank and then of all
    integer(i8), allocatable, intent(out) :: count(:) !! (body) particles of all ranks
    integer(i8) :: words(7*size(here)) ! particles of each body, then a count for each side of each body
    integer :: k, n
    n = size(here)
    words(:n) = here
    do k = 1, 6
      words(k*n + 1:(k + 1)*n) = merge(1_i8, 0_i8, btest(outside, k - 1))
    end do
    call sum_words(words)
    count = words(:n)
    do k = 1, 6
      where (words(k*n + 1:(k + 1)*n) > 0) outside = ibset(outside, k - 1)
    end do
  end subroutine join_counts

  !> The numbers of the particles of each body: of all, and of those that this rank makes. Collective
  subroutine number_particles(population)
    type(population_t), intent(inout) :: population
    integer(i8), allocatable :: before(:) ! (body) particles of the ranks before this one
    integer :: b
    population%here = population%fill%count
    do b = 1, size(population%table)
      if (allocated(population%table(b)%position)) population%here(b) = population%table(b)%n
    end do
    population%count = population%here
    before = population%here
    call sum_words(population%count)
    call words_before(before)
    allocate (population%first(size(before)))
    population%n = 0
    do b = 1, size(before)
      population%first(b) = population%n + 1
      population%n = population%n + population%count(b)
    end do
    population%from = population%first + before
  end subroutine number_particles

  !> The fill begins its messages, one a line, with "&body N 'name': "; the author of the scene is told the line of the group
  subroutine tell_fill(scene, bodies, message, error)
    type(scene_t), intent(in) :: scene
    type(fill_body_t), intent(in) :: bodies(:)
    character(len=*), intent(in) :: message
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: title, rest, this
    integer :: b, cut
    rest = message//new_line("a")
    do while (len(rest) > 0)
      cut = index(rest, new_line("a"))
      this = rest(:cut - 1)
      rest = rest(cut + 1:)
      do b = 1, size(bodies)
        title = "&body "//text_of(b)//" '"//trim(bodies(b)%name)//"': "
        if (index(this, title) == 1) exit
      end do
      if (b <= size(bodies)) then
        call complain(error, scene, "body", b, "", this(len(title) + 1:))
      else
        call add_error(error, this)
      end if
    end do
  end subroutine tell_fill

  !> Particles of a file must lie in the box, uninverted and of some width; the first that does not is told
  subroutine check_table(scene, s, table, error)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(in) :: s
    type(particle_table_t), intent(in) :: table
    type(error_t), allocatable, intent(out) :: error
    character(len=:), allocatable :: fault, this
    real(dp) :: x, f(9)
    integer(i8) :: i
    integer :: k
    do i = 1, table%n
      this = "particle "//text_of(table%first + i - 1)
      do k = 1, merge(0, scene%dimension, s%engine%grid%is_mesh) ! a mesh says itself what is outside
        x = (table%position(k, i) - s%engine%grid%lower(k))/s%engine%grid%spacing
        if (x >= 0.0_dp .and. x <= s%engine%grid%cells(k)) cycle
        call raise(error, this//" lies outside the box of &grid")
        return
      end do
      if (allocated(table%deformation_gradient)) then
        f(:scene%dimension**2) = table%deformation_gradient(:, i)
        if (determinant_of(scene%dimension, f) <= 0.0_dp) then
          call raise(error, this//" is inverted: its deformation_gradient must have a positive determinant")
          return
        end if
      end if
      if (s%engine%rule%carried /= carried_none) then
        fault = table_corner_fault(s%engine, table, i)
        if (fault /= "") then
          call raise(error, fault)
          return
        end if
      end if
      if (allocated(table%stress) .and. scene%dimension < 3) then ! such shear is not stored; round-off of other programs may pass
        k = merge(4, 5, scene%dimension == 1)
        if (any(abs(table%stress(k:, i)) > sqrt(epsilon(1.0_wp))*maxval(abs(table%stress(:, i))))) then
          call raise(error, "stress of "//this//" has shear out of the "//trim(merge("line ", "plane", scene%dimension == 1)) &
                     //": it must be zero")
          return
        end if
      end if
      if (.not. allocated(table%half_length)) cycle
      if (any(table%half_length(:, i) <= 0.0_dp)) then
        call raise(error, "half_length of "//this//" must be positive")
        return
      end if
    end do
  end subroutine check_table

  !> A body of the scene in the words of the fill
  subroutine describe_body(scene, b, body)
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: b
    type(fill_body_t), intent(out) :: body
    real(dp), allocatable :: points(:), normals(:)
    integer, allocatable :: per_axis(:)
    integer :: d, k
    d = scene%dimension
    body%name = text_of_key(scene, "body", b, "name")
    body%subtract = word_of(scene, "body", b, "operation") == "subtract"
    associate (shape => body%shape)
      select case (word_of(scene, "body", b, "shape"))
      case ("box")
        shape%kind = shape_box
        shape%lower(:d) = reals_of(scene, "body", b, "lower")
        shape%upper(:d) = reals_of(scene, "body", b, "upper")
      case ("sphere")
        shape%kind = shape_sphere
      case ("cylinder")
        shape%kind = shape_cylinder
      case ("ring")
        shape%kind = shape_ring
        shape%inner_radius = real_of(scene, "body", b, "inner_radius")
        shape%outer_radius = real_of(scene, "body", b, "outer_radius")
      case ("polygon")
        shape%kind = shape_polygon
        points = reals_of(scene, "body", b, "points")
        shape%vertices = reshape(points, [2, size(points)/2])
      case ("elements")
        shape%kind = shape_region
      case default
        shape%kind = shape_none
        return
      end select
      if (is_given(scene, "body", b, "center")) shape%center(:d) = reals_of(scene, "body", b, "center")
      if (is_given(scene, "body", b, "radius")) shape%radius = real_of(scene, "body", b, "radius")
      if (is_given(scene, "body", b, "axis")) shape%axis = index("xyz", word_of(scene, "body", b, "axis"))
      if (is_given(scene, "body", b, "axis_lower")) shape%axis_lower = real_of(scene, "body", b, "axis_lower")
      if (is_given(scene, "body", b, "axis_upper")) shape%axis_upper = real_of(scene, "body", b, "axis_upper")
      if (is_given(scene, "body", b, "cut_point")) then
        points = reals_of(scene, "body", b, "cut_point")
        normals = reals_of(scene, "body", b, "cut_normal")
        shape%cuts = size(points)/d
        do k = 1, shape%cuts
          shape%cut_point(:d, k) = points(d*(k - 1) + 1:d*k)
          shape%cut_normal(:d, k) = normals(d*(k - 1) + 1:d*k)
        end do
      end if
    end associate
    per_axis = integers_of(scene, "body", b, "particles_per_axis")
    body%particles_per_axis = 1
    body%particles_per_axis(:d) = per_axis(1)
    if (size(per_axis) == d) body%particles_per_axis(:d) = per_axis
    body%polar = word_of(scene, "body", b, "fill") == "polar"
    if (is_given(scene, "body", b, "radial_particles")) body%radial_particles = integer_of(scene, "body", b, "radial_particles")
    if (is_given(scene, "body", b, "angular_particles")) body%angular_particles = integer_of(scene, "body", b, "angular_particles")
  end subroutine describe_body

  !> The elements that a body is filled from
  subroutine describe_region(scene, s, b, body, region, error)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(in), target :: s
    integer, intent(in) :: b
    type(fill_body_t), intent(inout) :: body
    type(element_region_t), intent(inout), target :: region
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: name
    integer :: group
    associate (mesh => s%engine%mesh)
      name = text_of_key(scene, "body", b, "group")
      group = 0
      if (name /= "") then
        group = place_of(name, mesh%element_group_name)
        if (group == 0) call complain(error, scene, "body", b, "group", "the mesh has no group of elements of this name; " &
                                      //name_advice(name, mesh%element_group_name))
      end if
      if (allocated(error)) return
      if (s%engine%rule%carried == carried_box .and. any(kind_is_simplex(mesh%kind) .and. (group == 0 .or. mesh%element_group == group))) &
        call complain(error, scene, "body", b, "shape", "these elements hold triangles or tetrahedra, which make no boxes; set " &
                      //"particle_domain = 'simplex' in &method, which cuts the others too")
      call make_element_region(mesh, s%engine%locator, s%engine%grid%lower, s%engine%grid%spacing, group, body%particles_per_axis(1), &
                               s%engine%rule%carried == carried_simplex, region, body%shape%lower, body%shape%upper)
    end associate
    body%shape%region => region
  end subroutine describe_region

  pure real(dp) function determinant_of(d, f) result(j)
    integer, intent(in) :: d
    real(dp), intent(in) :: f(9)
    select case (d)
    case (1); j = f(1)
    case (2); j = f(1)*f(4) - f(2)*f(3)
    case default
      j = f(1)*(f(5)*f(9) - f(6)*f(8)) - f(2)*(f(4)*f(9) - f(6)*f(7)) + f(3)*(f(4)*f(8) - f(5)*f(7))
    end select
  end function determinant_of

end module gimp_population
