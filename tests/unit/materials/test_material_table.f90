!> The factory: every model is made, and every wrong, missing or meaningless key is named
program test_material_table
  use gimp_kinds, only: wp
  use gimp_error, only: error_t, report_lines
  use gimp_text, only: count_words, nth_word
  use gimp_material, only: material_t
  use gimp_material_table, only: make_material, material_models, material_options_t, unset, real_keys, word_keys, give_real, &
    give_word
  use gimp_material_options, only: is_set, real_option, word_option
  use gimp_hencky_von_mises, only: hencky_von_mises_t
  use gimp_drucker_prager, only: drucker_prager_t
  use gimp_linear_elastic, only: linear_elastic_t
  use gimp_objective_rates, only: hughes_winget, plain_hughes_winget, explicit_jaumann, green_naghdi, truesdell, logarithmic
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  call begin_suite("material_table")
  call check(material_models(), "neo_hookean linear_elastic hencky hencky_von_mises drucker_prager", "the words for model")
  call test_every_model()
  call test_rates()
  call test_defaults()
  call test_keys_by_name()
  call test_complaints()
  call end_suite()

contains

  !> Options that suit a model
  pure type(material_options_t) function sound(model) result(options)
    character(len=*), intent(in) :: model
    options%name = "block"
    options%model = model
    options%density = 1200
    options%young_modulus = 2.0e6_wp
    options%poisson_ratio = 0.25_wp
    if (model == "hencky_von_mises") options%yield_stress = 1.0e4_wp
    if (model == "drucker_prager") then
      options%cohesion = 0
      options%friction_angle = 30
    end if
  end function sound

  subroutine test_every_model()
    class(material_t), allocatable :: material
    type(error_t), allocatable :: error
    integer :: m
    do m = 1, count_words(material_models())
      call make_material(sound(nth_word(material_models(), m)), material, error)
      call check_true(.not. allocated(error), nth_word(material_models(), m)//" is made")
      if (allocated(error)) cycle
      call check(trim(material%model), nth_word(material_models(), m), "it knows its model")
      call check(trim(material%name), "block", "it knows its name")
      call check(material%density, 1200.0_wp, 0.0_wp, "density")
      call check([material%lambda, material%mu], [0.8e6_wp, 0.8e6_wp], 1.0e-9_wp, "Lame constants")
    end do
  end subroutine test_every_model

  subroutine test_rates()
    call rate_is("", "", hughes_winget, .true.)
    call rate_is("", "symmetric", hughes_winget, .false.)
    call rate_is("hughes_winget", "", hughes_winget, .true.)
    call rate_is("hughes_winget", "symmetric", hughes_winget, .false.)
    call rate_is("", "plain", plain_hughes_winget, .false.)
    call rate_is("jaumann", "", explicit_jaumann, .false.)
    call rate_is("green_naghdi", "", green_naghdi, .true.)
    call rate_is("truesdell", "midpoint", truesdell, .true.)
    call rate_is("logarithmic", "symmetric", logarithmic, .false.)
  end subroutine test_rates

  !> What a rate and a form make of a velocity gradient of the start of the step, and that nothing is done to one of its middle
  subroutine rate_is(rate, form, number, to_middle)
    character(len=*), intent(in) :: rate, form
    integer, intent(in) :: number
    logical, intent(in) :: to_middle
    class(material_t), allocatable :: material
    type(error_t), allocatable :: error
    type(material_options_t) :: options
    integer :: of_middle
    do of_middle = 0, 1
      options = sound("linear_elastic")
      options%rate = rate
      options%rate_form = form
      options%gradient_of_middle = of_middle == 1
      call make_material(options, material, error)
      call check_true(.not. allocated(error), "rate '"//rate//"', rate_form '"//form//"' is made")
      if (allocated(error)) return
      select type (material)
      type is (linear_elastic_t)
        call check(material%rate, number, "rate '"//rate//"', rate_form '"//form//"'")
        call check_true(material%to_middle .eqv. (to_middle .and. of_middle == 0), "rate_form '"//form//"': to the middle")
      class default
        call check_true(.false., "the model is linear elastic")
      end select
    end do
  end subroutine rate_is

  !> What is left out has the default of the input reference
  subroutine test_defaults()
    class(material_t), allocatable :: material
    type(error_t), allocatable :: error
    type(material_options_t) :: options
    options = sound("hencky_von_mises")
    options%hardening = "power"
    options%hardening_strain = 0.01_wp
    call make_material(options, material, error)
    select type (material)
    type is (hencky_von_mises_t)
      call check([material%yield_stress, material%exponent, material%strain], [1.0e4_wp, 1.0_wp, 0.01_wp], 0.0_wp, &
        "power hardening is linear in the plastic strain unless told otherwise")
    class default
      call check_true(.false., "the model is Hencky von Mises")
    end select
    options = sound("drucker_prager")
    options%cohesion = unset
    call make_material(options, material, error)
    select type (material)
    type is (drucker_prager_t)
      call check([material%eta, material%eta_bar, material%strength], [sqrt(3/13.0_wp), 0.0_wp, 0.0_wp], 1.0e-15_wp, &
        "plane strain cone, no dilation, no cohesion")
    class default
      call check_true(.false., "the model is Drucker-Prager")
    end select
  end subroutine test_defaults

  !> Every key can be given and asked by its name
  subroutine test_keys_by_name()
    type(material_options_t) :: options
    integer :: k
    do k = 1, count_words(real_keys)
      call check_true(.not. is_set(options, nth_word(real_keys, k)), nth_word(real_keys, k)//" starts unset")
      call give_real(options, nth_word(real_keys, k), real(k, wp))
    end do
    do k = 1, count_words(word_keys)
      call check_true(.not. is_set(options, nth_word(word_keys, k)), nth_word(word_keys, k)//" starts blank")
      call give_word(options, nth_word(word_keys, k), nth_word(word_keys, k))
    end do
    do k = 1, count_words(real_keys)
      call check(real_option(options, nth_word(real_keys, k)), real(k, wp), 0.0_wp, nth_word(real_keys, k))
    end do
    do k = 1, count_words(word_keys)
      call check(trim(word_option(options, nth_word(word_keys, k))), nth_word(word_keys, k), "word key")
    end do
  end subroutine test_keys_by_name

  subroutine test_complaints()
    type(material_options_t) :: options
    options = sound("rubber")
    call complains(options, "&material ""block"": model = 'rubber'; must be one of: "//material_models())
    options = sound("hencky")
    options%poisson_ratio = 0.62_wp
    call complains(options, "&material ""block"": poisson_ratio = 0.62; must lie between -1 and 0.5, both excluded")
    options = sound("neo_hookean")
    options%density = 0
    call complains(options, "&material ""block"": density = 0; must be above 0")
    options = sound("neo_hookean")
    options%yield_stress = 1
    call complains(options, "&material ""block"": yield_stress has no meaning for model = 'neo_hookean'; leave it out")
    options = sound("neo_hookean")
    options%rate = "jaumann"
    call complains(options, "&material ""block"": rate has no meaning for model = 'neo_hookean'; leave it out")
    options = material_options_t(name="block", model="hencky", density=1.0_wp, poisson_ratio=0.1_wp)
    call complains(options, "&material ""block"": young_modulus is missing; model = 'hencky' needs it")
    options = sound("linear_elastic")
    options%rate = "oldroyd"
    call complains(options, "&material ""block"": rate = 'oldroyd'; must be hughes_winget, jaumann, green_naghdi, truesdell or logarithmic")
    options = sound("linear_elastic")
    options%rate_form = "skew"
    call complains(options, "&material ""block"": rate_form = 'skew'; must be midpoint, symmetric or plain")
    options = sound("linear_elastic")
    options%rate = "jaumann"
    options%rate_form = "plain"
    call complains(options, "&material ""block"": rate_form has no meaning for rate = 'jaumann'; leave it out")
    options%rate = "truesdell"
    call complains(options, "&material ""block"": rate_form = 'plain'; is for rate = 'hughes_winget'; must be midpoint or symmetric")
    options = sound("hencky_von_mises")
    options%hardening = "voce"
    call complains(options, "&material ""block"": hardening = 'voce'; must be none, linear or power")
    options = sound("hencky_von_mises")
    options%hardening = "power"
    call complains(options, "&material ""block"": hardening_strain is missing; hardening = 'power' needs it")
    options = sound("hencky_von_mises")
    options%hardening_modulus = 3
    call complains(options, "&material ""block"": hardening_modulus has no meaning for this hardening; leave it out")
    options = sound("hencky_von_mises")
    options%hardening = "linear"
    options%hardening_modulus = -3
    call complains(options, "&material ""block"": hardening_modulus = -3; must not be below 0")
    options = sound("hencky_von_mises")
    options%hardening = "power"
    options%hardening_strain = 0.01_wp
    options%hardening_exponent = 1.5_wp
    call complains(options, "&material ""block"": hardening_exponent = 1.5; must lie between 0 and 1")
    options = sound("drucker_prager")
    options%dilation_angle = 31
    call complains(options, "&material ""block"": dilation_angle = 31; must lie between 0 and 30")
    options = sound("drucker_prager")
    options%friction_angle = 0
    call complains(options, "&material ""block"": friction_angle = 0; must be above 0 where cohesion is 0")
    options = sound("drucker_prager")
    options%cohesion = -1
    call complains(options, "&material ""block"": cohesion = -1; must not be below 0")
    options = sound("drucker_prager")
    options%cone = "round"
    call complains(options, "&material ""block"": cone = 'round'; must be plane_strain, outer or inner")
    options = material_options_t(name="block", model="drucker_prager", density=-1.0_wp, young_modulus=-2.0_wp, &
      poisson_ratio=0.5_wp, cohesion=-1.0_wp, friction_angle=90.0_wp, cone="round")
    call complains(options, "", messages=6)
  end subroutine test_complaints

  !> The message, or how many messages there are
  subroutine complains(options, message, messages)
    type(material_options_t), intent(in) :: options
    character(len=*), intent(in) :: message
    integer, intent(in), optional :: messages
    class(material_t), allocatable :: material
    type(error_t), allocatable :: error
    call make_material(options, material, error)
    call check_true(allocated(error) .and. .not. allocated(material), "refused: "//message)
    if (.not. allocated(error)) return
    if (present(messages)) then
      call check(report_lines(error), messages, "all mistakes in one go")
    else
      call check(error%message, message, "the message")
    end if
  end subroutine complains

end program test_material_table
