!> What the scene may say about a material, and the checks the models share.
module gimp_material_options
  use gimp_kinds, only: wp, dp
  use gimp_error, only: error_t, add_error
  use gimp_text, only: text_of, word_in
  use gimp_material, only: material_t
  implicit none(type, external)
  private
  public :: material_options_t, unset, real_keys, word_keys, real_option, word_option, is_set
  public :: give_real, give_word
  public :: set_elasticity, need, refuse, demand_above, demand_at_least, demand_within, complain

  !> A number the scene does not give
  real(dp), parameter :: unset = -huge(1.0_dp)

  !> The keys of a material; what stays unset (or blank) was not given
  type :: material_options_t
    character(len=32) :: name = "" !! for messages and output
    character(len=32) :: model = "" !! word of the model table
    real(dp) :: density = unset !! [kg/m3]
    real(dp) :: young_modulus = unset !! [Pa]
    real(dp) :: poisson_ratio = unset
    real(dp) :: yield_stress = unset !! initial uniaxial yield stress [Pa]
    real(dp) :: hardening_modulus = unset !! [Pa]; default 0
    real(dp) :: hardening_exponent = unset !! default 1
    real(dp) :: hardening_strain = unset
    real(dp) :: cohesion = unset !! [Pa]; default 0
    real(dp) :: friction_angle = unset !! [degree]
    real(dp) :: dilation_angle = unset !! [degree]; default 0
    character(len=32) :: hardening = "" !! none (default), linear, power
    character(len=32) :: cone = "" !! plane_strain (default), outer, inner
    character(len=32) :: rate = "" !! hughes_winget (default), jaumann, green_naghdi, truesdell, logarithmic
    character(len=32) :: rate_form = "" !! midpoint (default), symmetric, plain
    logical :: gradient_of_middle = .false. !! the increment of F takes the velocity gradient for that of the middle of the step
  end type material_options_t

  !> Names of the number keys and of the word keys, for checks that walk them all
  character(len=*), parameter :: real_keys = "density young_modulus poisson_ratio yield_stress hardening_modulus " &
    //"hardening_exponent hardening_strain cohesion friction_angle dilation_angle"
  character(len=*), parameter :: word_keys = "hardening cone rate rate_form"

contains

  !> A number key by name; `unset` where the scene does not give it or there is no such key
  pure real(dp) function real_option(options, key)
    type(material_options_t), intent(in) :: options
    character(len=*), intent(in) :: key
    select case (key)
    case ("density")
      real_option = options%density
    case ("young_modulus")
      real_option = options%young_modulus
    case ("poisson_ratio")
      real_option = options%poisson_ratio
    case ("yield_stress")
      real_option = options%yield_stress
    case ("hardening_modulus")
      real_option = options%hardening_modulus
    case ("hardening_exponent")
      real_option = options%hardening_exponent
    case ("hardening_strain")
      real_option = options%hardening_strain
    case ("cohesion")
      real_option = options%cohesion
    case ("friction_angle")
      real_option = options%friction_angle
    case ("dilation_angle")
      real_option = options%dilation_angle
    case default
      real_option = unset
    end select
  end function real_option

  !> A word key by name; blank where the scene does not give it or there is no such key
  pure function word_option(options, key) result(word)
    type(material_options_t), intent(in) :: options
    character(len=*), intent(in) :: key
    character(len=32) :: word
    select case (key)
    case ("hardening")
      word = options%hardening
    case ("cone")
      word = options%cone
    case ("rate")
      word = options%rate
    case ("rate_form")
      word = options%rate_form
    case default
      word = ""
    end select
  end function word_option

  !> Set a number key by name, so that whoever reads a scene can walk `real_keys`
  pure subroutine give_real(options, key, value)
    type(material_options_t), intent(inout) :: options
    character(len=*), intent(in) :: key !! one of `real_keys`
    real(dp), intent(in) :: value
    select case (key)
    case ("density")
      options%density = value
    case ("young_modulus")
      options%young_modulus = value
    case ("poisson_ratio")
      options%poisson_ratio = value
    case ("yield_stress")
      options%yield_stress = value
    case ("hardening_modulus")
      options%hardening_modulus = value
    case ("hardening_exponent")
      options%hardening_exponent = value
    case ("hardening_strain")
      options%hardening_strain = value
    case ("cohesion")
      options%cohesion = value
    case ("friction_angle")
      options%friction_angle = value
    case ("dilation_angle")
      options%dilation_angle = value
    end select
  end subroutine give_real

  !> Set a word key by name, so that whoever reads a scene can walk `word_keys`
  pure subroutine give_word(options, key, value)
    type(material_options_t), intent(inout) :: options
    character(len=*), intent(in) :: key !! one of `word_keys`
    character(len=*), intent(in) :: value
    select case (key)
    case ("hardening")
      options%hardening = value
    case ("cone")
      options%cone = value
    case ("rate")
      options%rate = value
    case ("rate_form")
      options%rate_form = value
    end select
  end subroutine give_word

  !> Whether the scene gives a key
  pure logical function is_set(options, key)
    type(material_options_t), intent(in) :: options
    character(len=*), intent(in) :: key
    is_set = real_option(options, key) /= unset .or. word_option(options, key) /= ""
  end function is_set

  !> Density and the Lame constants from Young's modulus and Poisson's ratio, with their checks
  subroutine set_elasticity(options, material, error)
    type(material_options_t), intent(in) :: options
    class(material_t), intent(inout) :: material
    type(error_t), allocatable, intent(inout) :: error
    call demand_above(options, "density", 0.0_dp, error)
    call demand_above(options, "young_modulus", 0.0_dp, error)
    if (.not. (options%poisson_ratio > -1.0_dp .and. options%poisson_ratio < 0.5_dp)) &
      call complain(options, "poisson_ratio", "must lie between -1 and 0.5, both excluded", error)
    if (allocated(error)) return
    material%name = options%name
    material%model = options%model
    material%density = real(options%density, wp)
    material%mu = real(options%young_modulus/(2*(1 + options%poisson_ratio)), wp)
    material%lambda = real(options%young_modulus*options%poisson_ratio/((1 + options%poisson_ratio)*(1 - 2*options%poisson_ratio)), wp)
  end subroutine set_elasticity

  !> Complain about a key that is missing; `reason` says what asks for it
  subroutine need(options, key, reason, error)
    type(material_options_t), intent(in) :: options
    character(len=*), intent(in) :: key, reason
    type(error_t), allocatable, intent(inout) :: error
    if (is_set(options, key)) return
    call add_error(error, "&material """//trim(options%name)//""": "//key//" is missing; "//reason//" needs it")
  end subroutine need

  !> Complain about a key that would be ignored; `reason` says what has no use for it
  subroutine refuse(options, key, reason, error)
    type(material_options_t), intent(in) :: options
    character(len=*), intent(in) :: key, reason
    type(error_t), allocatable, intent(inout) :: error
    if (.not. is_set(options, key)) return
    call add_error(error, "&material """//trim(options%name)//""": "//key//" has no meaning for "//reason//"; leave it out")
  end subroutine refuse

  !> Complain unless a number lies above a limit
  subroutine demand_above(options, key, limit, error)
    type(material_options_t), intent(in) :: options
    character(len=*), intent(in) :: key
    real(dp), intent(in) :: limit
    type(error_t), allocatable, intent(inout) :: error
    real(dp) :: value
    value = real_option(options, key)
    if (value > limit .and. value <= huge(1.0_dp)) return
    call complain(options, key, "must be above "//text_of(limit), error)
  end subroutine demand_above

  !> Complain if a number is below a limit, which itself is allowed
  subroutine demand_at_least(options, key, limit, error)
    type(material_options_t), intent(in) :: options
    character(len=*), intent(in) :: key
    real(dp), intent(in) :: limit
    type(error_t), allocatable, intent(inout) :: error
    real(dp) :: value
    value = real_option(options, key)
    if (value >= limit .and. value <= huge(1.0_dp)) return
    call complain(options, key, "must not be below "//text_of(limit), error)
  end subroutine demand_at_least

  !> Complain unless a number lies between two limits, both allowed
  subroutine demand_within(options, key, low, high, error)
    type(material_options_t), intent(in) :: options
    character(len=*), intent(in) :: key
    real(dp), intent(in) :: low, high
    type(error_t), allocatable, intent(inout) :: error
    real(dp) :: value
    value = real_option(options, key)
    if (value >= low .and. value <= high) return
    call complain(options, key, "must lie between "//text_of(low)//" and "//text_of(high), error)
  end subroutine demand_within

  !> Where, what, and what would be right
  subroutine complain(options, key, right, error)
    type(material_options_t), intent(in) :: options
    character(len=*), intent(in) :: key
    character(len=*), intent(in) :: right !! in words
    type(error_t), allocatable, intent(inout) :: error
    if (word_in(key, real_keys) > 0) then
      call add_error(error, "&material """//trim(options%name)//""": "//key//" = "//text_of(real_option(options, key)) &
        //"; "//right)
    else
      call add_error(error, "&material """//trim(options%name)//""": "//key//" = '"//trim(word_option(options, key)) &
        //"'; "//right)
    end if
  end subroutine complain

end module gimp_material_options
