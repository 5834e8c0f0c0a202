!> The unstructured mesh of a scene, from its file to what the transfers work on
module gimp_setup_mesh
  use gimp_kinds, only: wp, dp, precision_word
  use gimp_error, only: error_t
  use gimp_grid, only: grid_t
  use gimp_mesh, only: mesh_t, kind_name, triangle6, quad8, quad9
  use gimp_mesh_file, only: read_mesh
  use gimp_patches, only: make_patches
  use gimp_mesh_connect, only: connect_mesh
  use gimp_search, only: make_locator, rule_velocity, rule_component
  use gimp_engine, only: engine_t
  use gimp_run_state, only: stepper_t
  use gimp_setup_sides, only: set_up_mesh_walls
  use gimp_scene, only: scene_t, real_of, word_of, text_of_key, complain
  implicit none(type, external)
  private
  public :: set_up_mesh

contains

  !> Read the mesh, and give its sides their conditions. Collective
  subroutine set_up_mesh(scene, s, error)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(inout) :: s
    type(error_t), allocatable, intent(inout) :: error
    type(error_t), allocatable :: problem
    real(dp) :: lower(3), length
    if (precision_word /= "double") then
      call complain(error, scene, "mesh", 1, "file", "meshes are for the program in double precision, gimp.x; this one is in "//precision_word)
      return
    end if
    lower = 0.0_dp
    length = real_of(scene, "mesh", 1, "reference_length") ! 0: not given
    associate (engine => s%engine)
      call read_mesh(text_of_key(scene, "mesh", 1, "file"), scene%dimension, lower, length, engine%mesh, problem)
      if (allocated(problem)) then
        call tell_mesh(scene, problem%message, error)
        return
      end if
      call check_kinds(scene, engine%mesh, error)
      if (allocated(error)) return
      call make_patches(engine%mesh, engine%patches)
      call connect_mesh(engine%mesh)
      call make_locator(engine%mesh, engine%locator)
      engine%grid = grid_around(engine, scene%dimension, lower, length)
      engine%search_rule = merge(rule_component, rule_velocity, word_of(scene, "mesh", 1, "search_rule") == "component")
      call set_up_mesh_walls(scene, engine, s%walls, error)
    end associate
  end subroutine set_up_mesh

  !> Elements that lumped masses, or the chosen shape functions, cannot be had with
  subroutine check_kinds(scene, mesh, error)
    type(scene_t), intent(in) :: scene
    type(mesh_t), intent(in) :: mesh
    type(error_t), allocatable, intent(inout) :: error
    call refuse(triangle6, "the shape functions of their corners have an integral of zero, so that those nodes have next to no mass; make a " &
                //"mesh of triangle3")
    call refuse(quad8, "the shape functions of their corners have a negative integral, so that those nodes have a negative mass; make a mesh " &
                //"of quad4")
    call refuse(quad9, "their shape functions are negative in parts, so that nodes at the rim of a body get negative masses; make a mesh of quad4")

  contains

    subroutine refuse(kind, why)
      integer, intent(in) :: kind
      character(len=*), intent(in) :: why
      if (any(mesh%kind == kind)) &
        call complain(error, scene, "mesh", 1, "file", "holds elements of kind "//trim(kind_name(kind))//": "//why)
    end subroutine refuse

  end subroutine check_kinds

  !> The box around a mesh in the words of a grid; the last cells may reach beyond it
  pure function grid_around(engine, dim, lower, length) result(grid)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: dim
    real(dp), intent(in) :: lower(3), length !! [m]
    type(grid_t) :: grid
    real(dp), parameter :: round_off = 1.0e-9_dp
    grid%dim = dim
    grid%is_mesh = .true.
    grid%lower(:dim) = lower(:dim)
    grid%spacing = length
    grid%cells(:dim) = max(1, ceiling(maxval(engine%mesh%x, dim=2) - round_off))
    grid%edge = 0
  end function grid_around

  !> What is wrong with a mesh file, one mistake a line; each begins with the path, which the scene has said already
  subroutine tell_mesh(scene, message, error)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: message
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: path, rest, this
    integer :: cut
    path = text_of_key(scene, "mesh", 1, "file")//": "
    rest = message//new_line("a")
    do while (len(rest) > 0)
      cut = index(rest, new_line("a"))
      this = rest(:cut - 1)
      rest = rest(cut + 1:)
      if (index(this, path) == 1) this = this(len(path) + 1:)
      call complain(error, scene, "mesh", 1, "file", this)
    end do
  end subroutine tell_mesh

end module gimp_setup_mesh
