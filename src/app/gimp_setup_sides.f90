!> What acts from outside: conditions on sides, loads on bodies and on sides of a mesh
module gimp_setup_sides
  use gimp_kinds, only: dp, precision_word
  use gimp_error, only: error_t, add_error
  use gimp_text, only: text_of, lower
  use gimp_mesh, only: mesh_t
  use gimp_walls, only: walls_t, wall_t, is_wall, side_of_word, condition_of_word
  use gimp_mesh_walls, only: set_mesh_walls
  use gimp_time_table, only: time_table_t
  use gimp_loads, only: loads_t, load_traction, load_pressure, load_point, most_face_loads, set_side_loads
  use gimp_engine, only: engine_t, leaving_stops, leaving_held, leaving_removes
  use gimp_scene_mistakes, only: suggestion
  use gimp_scene, only: scene_t, count_groups, is_given, real_of, reals_of, word_of, text_of_key, complain
  implicit none(type, external)
  private
  public :: set_up_walls, set_up_mesh_walls, set_up_loads, is_on_particles, place_of, name_advice, no_name

  character(len=*), parameter :: no_name = "(no name)" !! what sides of a mesh are called that no group of its file has

contains

  !> Sides of the box; without a group they are free
  subroutine set_up_walls(scene, walls)
    type(scene_t), intent(in) :: scene
    type(walls_t), intent(inout) :: walls
    character(len=:), allocatable :: side
    integer :: b, axis, end, a, e
    do b = 1, count_groups(scene, "boundary")
      side = word_of(scene, "boundary", b, "side")
      call side_of_word(side, axis, end)
      do a = 1, scene%dimension
        do e = 1, 2
          if (side /= "all" .and. (a /= axis .or. e /= end)) cycle
          call describe_wall(scene, b, walls%side(e, a))
        end do
      end do
    end do
  end subroutine set_up_walls

  !> The condition of a group &boundary
  subroutine describe_wall(scene, b, wall)
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: b
    type(wall_t), intent(inout) :: wall
    wall%condition = condition_of_word(word_of(scene, "boundary", b, "condition"))
    wall%removes = word_of(scene, "boundary", b, "condition") == "free" .and. word_of(scene, "boundary", b, "leaving") == "remove"
    if (is_given(scene, "boundary", b, "velocity")) wall%velocity(:scene%dimension) = reals_of(scene, "boundary", b, "velocity")
    call set_up_table(scene, "boundary", b, wall%table)
  end subroutine describe_wall

  !> Conditions on the named sides of a mesh, and what happens to particles beyond its sides
  subroutine set_up_mesh_walls(scene, engine, walls, error)
    type(scene_t), intent(in) :: scene
    type(engine_t), intent(inout) :: engine !! its mesh is connected
    type(walls_t), intent(inout) :: walls
    type(error_t), allocatable, intent(inout) :: error
    type(error_t), allocatable :: problem
    type(wall_t), allocatable :: condition(:)
    integer :: b, k, group
    associate (mesh => engine%mesh)
      if (any([(lower(text_of_key(scene, "boundary", b, "side")) == "all", b=1, count_groups(scene, "boundary"))])) &
        call name_all_sides(mesh)
      allocate (condition(size(mesh%side_group_name)))
      do b = 1, count_groups(scene, "boundary")
        if (lower(text_of_key(scene, "boundary", b, "side")) == "all") then
          do k = 1, size(condition)
            call describe_wall(scene, b, condition(k))
          end do
        else
          group = find_side(scene, mesh, "boundary", b, error)
          if (group > 0) call describe_wall(scene, b, condition(group))
        end if
      end do
      if (allocated(error)) return
      call set_mesh_walls(walls, mesh, condition, problem)
      if (allocated(problem)) then
        call add_error(error, problem%message)
        return
      end if
      allocate (engine%leaving(size(mesh%side_group)), source=leaving_stops)
      do k = 1, size(engine%leaving)
        group = mesh%side_group(k)
        if (group == 0) cycle
        if (condition(group)%removes) engine%leaving(k) = leaving_removes
        if (is_wall(condition(group))) engine%leaving(k) = leaving_held
      end do
    end associate
  end subroutine set_up_mesh_walls

  !> A group for the boundary sides that have none
  subroutine name_all_sides(mesh)
    type(mesh_t), intent(inout) :: mesh
    if (all(mesh%side_group > 0)) return
    mesh%side_group_name = [character(len=len(mesh%side_group_name)) :: mesh%side_group_name, no_name]
    where (mesh%side_group == 0) mesh%side_group = size(mesh%side_group_name)
  end subroutine name_all_sides

  !> The group of sides that a key `side` names; 0 if there is none, which is told
  integer function find_side(scene, mesh, group, which, error) result(side)
    type(scene_t), intent(in) :: scene
    type(mesh_t), intent(in) :: mesh
    character(len=*), intent(in) :: group
    integer, intent(in) :: which
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: name
    name = text_of_key(scene, group, which, "side")
    side = place_of(name, mesh%side_group_name)
    if (side == 0) then
      call complain(error, scene, group, which, "side", "the mesh has no side of this name; "//name_advice(name, mesh%side_group_name))
    else if (.not. any(mesh%side_group == side)) then
      call complain(error, scene, group, which, "side", "none of the sides of this name is on the boundary of the mesh")
      side = 0
    end if
  end function find_side

  !> Which of the names it is, 0 if none
  pure integer function place_of(name, names) result(place)
    character(len=*), intent(in) :: name, names(:)
    do place = size(names), 1, -1
      if (names(place) == name) exit
    end do
  end function place_of

  !> "did you mean ...?" for names that may hold blanks
  pure function name_advice(name, names) result(text)
    character(len=*), intent(in) :: name, names(:)
    character(len=:), allocatable :: text, known
    character(len=1), parameter :: joint = achar(31) ! in place of a blank within a name
    integer :: k
    known = ""
    do k = 1, size(names)
      known = known//swapped(trim(names(k)), " ", joint)//" "
    end do
    text = swapped(suggestion(swapped(name, " ", joint), known, '"'), joint, " ")
  contains
    pure function swapped(text, old, new)
      character(len=*), intent(in) :: text
      character(len=1), intent(in) :: old, new
      character(len=len(text)) :: swapped
      integer :: i
      do i = 1, len(text)
        swapped(i:i) = merge(new, text(i:i), text(i:i) == old)
      end do
    end function swapped
  end function name_advice

  !> Times and factors, and the ramp of loads
  subroutine set_up_table(scene, group, which, table)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group
    integer, intent(in) :: which
    type(time_table_t), intent(inout) :: table
    if (is_given(scene, group, which, "times")) then
      table%times = reals_of(scene, group, which, "times")
      table%factors = reals_of(scene, group, which, "factors")
    end if
    if (group == "load") table%ramp_time = real_of(scene, group, which, "ramp_time")
  end subroutine set_up_table

  !> Whether a load acts on particles: not gravity, which acts on all, and not one on sides of the mesh
  pure logical function is_on_particles(scene, k)
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: k
    is_on_particles = word_of(scene, "load", k, "kind") /= "gravity" .and. .not. is_given(scene, "load", k, "side")
  end function is_on_particles

  subroutine set_up_loads(scene, engine, loads, error)
    type(scene_t), intent(in) :: scene
    type(engine_t), intent(in) :: engine
    type(loads_t), intent(inout) :: loads
    type(error_t), allocatable, intent(inout) :: error
    integer :: k, gravity, sides, particles, faces
    gravity = 0
    sides = 0
    do k = 1, count_groups(scene, "load")
      if (word_of(scene, "load", k, "kind") == "gravity") gravity = gravity + 1
      if (is_given(scene, "load", k, "side")) sides = sides + 1
    end do
    allocate (loads%gravity(gravity), loads%side(sides), loads%load(count_groups(scene, "load") - gravity - sides))
    gravity = 0
    sides = 0
    particles = 0
    faces = 0
    do k = 1, count_groups(scene, "load")
      if (word_of(scene, "load", k, "kind") == "gravity") then
        gravity = gravity + 1
        loads%gravity(gravity)%acceleration(:scene%dimension) = reals_of(scene, "load", k, "acceleration")
        call set_up_table(scene, "load", k, loads%gravity(gravity)%table)
      else if (is_given(scene, "load", k, "side")) then
        sides = sides + 1
        call set_up_side_load(k, sides)
      else
        particles = particles + 1
        call set_up_particle_load(k, particles)
      end if
    end do
    if (sides > 0 .and. .not. allocated(error)) call set_side_loads(loads, engine%mesh, engine%grid%spacing)

  contains

    subroutine set_up_side_load(k, n)
      integer, intent(in) :: k, n
      associate (load => loads%side(n))
        load%group = find_side(scene, engine%mesh, "load", k, error)
        call set_up_table(scene, "load", k, load%table)
        if (word_of(scene, "load", k, "kind") == "traction") then
          load%vector(:scene%dimension) = reals_of(scene, "load", k, "traction")
        else
          load%pressure = real_of(scene, "load", k, "pressure")
        end if
      end associate
    end subroutine set_up_side_load

    subroutine set_up_particle_load(k, n)
      integer, intent(in) :: k, n
      associate (load => loads%load(n), d => scene%dimension)
        call set_up_table(scene, "load", k, load%table)
        select case (word_of(scene, "load", k, "kind"))
        case ("traction")
          load%kind = load_traction
          load%vector(:d) = reals_of(scene, "load", k, "traction")
        case ("pressure")
          load%kind = load_pressure
          load%pressure = real_of(scene, "load", k, "pressure")
        case default
          load%kind = load_point
          load%vector(:d) = reals_of(scene, "load", k, "force")
        end select
        if (load%kind == load_point) return
        load%place = faces
        faces = faces + 1
        if (faces > most_face_loads) call complain(error, scene, "load", k, "kind", &
          "a scene can hold at most "//text_of(most_face_loads)//" face loads in "//precision_word//" precision")
      end associate
    end subroutine set_up_particle_load

  end subroutine set_up_loads

end module gimp_setup_sides
