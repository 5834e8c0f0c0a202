!> Mistakes in scenes: each is told once, with line, group, key, value and what would be right.
!> More of them, run through the program itself, are in tests/bad_inputs.
program test_scene_mistakes
  use gimp_check, only: begin_suite, end_suite, check, check_true
  use gimp_error, only: error_t, report_lines
  use gimp_scene, only: scene_t, parse_scene
  use gimp_scene_mistakes, only: mistakes_t, note_mistake, tell_mistakes, suggestion, or_list
  implicit none(type, external)
  character(len=1), parameter :: nl = new_line("a")
  character(len=*), parameter :: head = "&scene dimension = 2 /"//nl//"&grid lower = 2*0 upper = 2*1 spacing = 0.1 /"//nl
  character(len=*), parameter :: elastic = ' density = 1 young_modulus = 1 poisson_ratio = 0'
  character(len=*), parameter :: rubber = '&material name = "rubber" model = "neo_hookean"'//elastic//' /'//nl
  character(len=*), parameter :: block = '&body name = "block" material = "rubber" shape = "box" lower = 2*0.2 upper = 2*0.8 /'//nl
  character(len=*), parameter :: finish = "&time end = 1 /"//nl

  call begin_suite("scene mistakes")
  call test_order_and_words()
  call test_values()
  call test_choices()
  call test_materials()
  call test_bodies()
  call test_polygons()
  call test_boundaries_and_loads()
  call test_time_and_output()
  call test_one_slip_one_message()
  call end_suite()

contains

  !> The scene gives exactly this text; empty: it is sound
  subroutine says(text, expected)
    character(len=*), intent(in) :: text, expected
    type(scene_t) :: scene
    type(error_t), allocatable :: error
    call parse_scene(text, scene, error)
    if (allocated(error)) call check(error%message, expected, "messages")
    if (.not. allocated(error)) call check("", expected, "messages")
  end subroutine says

  !> A line in a sound scene gives this message
  subroutine extra_says(line, expected)
    character(len=*), intent(in) :: line, expected
    if (expected == "") call says(head//rubber//block//finish//line, "")
    if (expected /= "") call says(head//rubber//block//finish//line, "line 6: "//expected)
  end subroutine extra_says

  subroutine material_says(keys, expected)
    character(len=*), intent(in) :: keys, expected
    character(len=:), allocatable :: text
    text = head//'&material name = "rubber" '//keys//' /'//nl//block//finish
    if (expected == "") call says(text, "")
    if (expected /= "") call says(text, "line 3: &material: "//expected)
  end subroutine material_says

  !> A second body in a sound scene
  subroutine body_says(keys, expected)
    character(len=*), intent(in) :: keys, expected
    if (expected == "") call extra_says('&body name = "b" material = "rubber" '//keys//' /', "")
    if (expected /= "") call extra_says('&body name = "b" material = "rubber" '//keys//' /', "&body: "//expected)
  end subroutine body_says

  subroutine time_says(keys, expected)
    character(len=*), intent(in) :: keys, expected
    if (expected == "") call says(head//rubber//block//"&time end = 1 "//keys//" /", "")
    if (expected /= "") call says(head//rubber//block//"&time end = 1 "//keys//" /", "line 5: &time: "//expected)
  end subroutine time_says

  subroutine test_order_and_words()
    type(mistakes_t) :: mistakes
    type(error_t), allocatable :: error
    integer :: k
    call note_mistake(mistakes, 0, "last")
    do k = 40, 1, -1
      call note_mistake(mistakes, k, "a")
    end do
    call note_mistake(mistakes, 7, "b")
    call note_mistake(mistakes, 7, "a")
    call tell_mistakes(mistakes, error)
    call check(report_lines(error), 42, "the same is told once")
    call check_true(index(error%message, "line 1: a"//nl//"line 2: a") == 1, "in the order of the lines")
    call check_true(index(error%message, "line 7: a"//nl//"line 7: b"//nl//"line 8: a") > 0, "in one line as they were found")
    call check_true(index(error%message, nl//"last") == len(error%message) - 4, "what has no line comes last")
    call check(suggestion("ugmip", "linear ugimp cpgimp", '"'), 'did you mean "ugimp"?', "two letters swapped")
    call check(suggestion("materials", "mesh material", "&"), "did you mean &material?", "a letter too many")
    call check(suggestion("q", "linear ugimp", '"'), "known: linear, ugimp", "nothing near")
    call check(suggestion("q", "", '"'), "there is none to choose from", "nothing known")
    call check(or_list("a b c"), "a, b or c", "a list with or")
  end subroutine test_order_and_words

  subroutine test_values()
    call says("", "the scene on standard input is empty; gimp.x --help shows what belongs there")
    call says(head//rubber//block//finish, "")
    call extra_says("&output every = 1.0e-3 csv = .false. /", "")
    call extra_says("&output every = 1.0e-3 csv = no /", "&output: csv = no; .true. or .false. is wanted, without quotes")
    call extra_says('&output every = -1 /', "&output: every = -1; must be at least 0 s")
    call extra_says('&output history_every = 1.5 /', '&output: history_every = 1.5; "1.5" is not a whole number; '// &
                    "a whole number of at least 1 is wanted")
    call extra_says('&output name = run /', '&output: name = run; words and texts stand in quotes: "run"')
    call extra_says('&output nmae = "run" /', '&output: nmae = "run"; there is no such key; did you mean name?')
    call extra_says('&output fields = "velocity", "vorticity" /', '&output: fields = "velocity", "vorticity"; '// &
                    'there is no such word; known: displacement, velocity, stress, smoothed_stress, deformation_gradient, pressure, von_mises, '// &
                    'equivalent_plastic_strain, volume, mass, density, id, material, body, jacobian, half_length, error, '// &
                    'reference_position')
    call extra_says('&output precision = "single" precision = "single" /', &
                    '&output: precision = "single"; the key is set already in line 6')
    call extra_says('&outptu /', "&outptu: there is no such group; did you mean &output?")
    call extra_says('&time end = 2 /', "&time: the group may stand once; it stands already in line 5")
    call extra_says('&refine levels = 2 /', "&refine: is planned, not built yet")
    call extra_says('&method integrator = "implicit" /', '&method: integrator = "implicit"; "implicit" is planned, not built '// &
                    "yet; there is symplectic, generalized_alpha or newmark")
    call extra_says('&method mass_cutoff = 1 /', "&method: mass_cutoff = 1; must be at least 0 and below 1")
  end subroutine test_values

  !> Keys that the choices made do not read
  subroutine test_choices()
    call extra_says('&method transfer = "pic" flip_fraction = 0.5 /', &
                    "&method: flip_fraction = 0.5; is not read by transfer pic, only by flip, apic, tpic or mls")
    call extra_says('&method basis = "ugimp" domain = "volume" /', &
                    '&method: domain = "volume"; is not read by basis ugimp, only by cpgimp')
    call extra_says('&method damping = "local" damping_factor = 0.5 /', "")
    call body_says('shape = "sphere" center = 2*0.5 radius = 0.1 lower = 2*0.1', &
                   "lower = 0.1, 0.1; is not read by shape sphere, only by box")
    call body_says('shape = "sphere" center = 2*0.5 radius = 0.1 initial = "verification" velocity = 1, 0 /'//nl// &
                   '&verification solution = "vortex"', "velocity = 1, 0; is not read by initial verification, only by rest")
    call body_says('shape = "sphere" center = 2*0.5 radius = 0.1 operation = "subtract" particles_per_axis = 2', &
                   "particles_per_axis = 2; is not read by operation subtract, only by add")
    call body_says('shape = "sphere" center = 2*0.5 radius = 0.1 operation = "subtract"', "")
    call extra_says('&body name = "hole" shape = "sphere" center = 2*0.5 radius = 0.1 operation = "subtract" /', "")
    call extra_says('&body name = "b" shape = "sphere" center = 2*0.5 radius = 0.1 /', &
                    "&body: material is not set; a text in quotes is wanted")
    call body_says('shape = "ring" center = 2*0.5 inner_radius = 0.1 outer_radius = 0.2 fill = "polar" radial_particles = 3', &
                   "angular_particles is not set; a whole number of at least 3 is wanted")
    call body_says('shape = "ring" center = 2*0.5 inner_radius = 0.1 outer_radius = 0.2 fill = "polar" radial_particles = 3 '// &
                   'angular_particles = 9 particles_per_axis = 2', &
                   "particles_per_axis = 2; is not read by fill polar, only by cartesian")
    call extra_says('&verification solution = "axis_aligned" speed = 1 /', &
                    "&verification: speed = 1; is not read by solution axis_aligned, only by vibrating_bar")
    call extra_says('&verification solution = "rigid_translation" /', &
                    "&verification: velocity is not set; a number [m/s] is wanted")
  end subroutine test_choices

  subroutine test_materials()
    call material_says('model = "drucker_prager" friction_angle = 30 dilation_angle = 30'//elastic, "")
    call material_says('model = "drucker_prager" friction_angle = 30 dilation_angle = 31'//elastic, &
                       "dilation_angle = 31; must be at most friction_angle = 30")
    call material_says('model = "drucker_prager" friction_angle = 89'//elastic, &
                       "friction_angle = 89; must be at least 0 and below 89 degree")
    call material_says('model = "hencky_von_mises" yield_stress = 1 hardening = "linear" hardening_modulus = 2'//elastic, "")
    call material_says('model = "hencky_von_mises" yield_stress = 1 hardening_modulus = 2'//elastic, &
                       "hardening_modulus = 2; is not read by hardening none, only by linear")
    call material_says('model = "hencky_von_mises" yield_stress = 1 hardening = "power" hardening_strain = 0'//elastic, &
                       "hardening_strain = 0; must be above 0")
    call material_says('model = "linear_elastic" rate = "jauman"'//elastic, &
                       'rate = "jauman"; there is no such word; did you mean "jaumann"?')
    call material_says('model = "linear_elastic" rate = "truesdell" rate_form = "symmetric"'//elastic, "")
    call material_says('model = "linear_elastic" rate = "truesdell" rate_form = "plain"'//elastic, 'rate_form = "plain"; is for '// &
                       "rate = 'hughes_winget'; midpoint or symmetric is wanted with rate = 'truesdell'")
    call material_says('model = "linear_elastic" rate = "jaumann" rate_form = "plain"'//elastic, 'rate_form = "plain"; is not read '// &
                       "by rate jaumann, only by hughes_winget, green_naghdi, truesdell or logarithmic")
    call material_says(elastic, "model is not set; neo_hookean, linear_elastic, hencky, hencky_von_mises or drucker_prager "// &
                       "is wanted")
    call extra_says('&material name = "rubber" model = "hencky"'//elastic//' /', &
                    '&material: name = "rubber"; the name is taken by the &material of line 3')
  end subroutine test_materials

  subroutine test_bodies()
    call body_says('shape = "box" lower = 0.1, 0.5 upper = 0.4, 0.5', &
                   "upper = 0.4, 0.5; must be above lower along y: 0.5 is not above 0.5")
    call body_says('shape = "ring" center = 2*0.5 inner_radius = 0.2 outer_radius = 0.2', &
                   "inner_radius = 0.2; must be below outer_radius = 0.2")
    call body_says('shape = "sphere" center = 2*0.5 radius = 0.1 cut_point = 0.5, 0.5 cut_normal = 1, 0, 0, 1', &
                   "cut_normal = 1, 0, 0, 1; has 2 normals for 1 points of cut_point")
    call body_says('shape = "sphere" center = 2*0.5 radius = 0.1 cut_point = 10*0.5 cut_normal = 8*1', &
                   "cut_point = 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5; has 10 numbers; at most 8 are taken in 2D")
    call body_says('shape = "sphere" center = 2*0.5 radius = 0.1 deformation_gradient = 0, 1, 1, 0', &
                   "deformation_gradient = 0, 1, 1, 0; the determinant must be above 0")
    call body_says('shape = "sphere" center = 2*0.5 radius = 0.1 particles_per_axis = 3*2', &
                   "particles_per_axis = 2, 2, 2; has 3 values; one for all axes or 2 are wanted in 2D")
    call body_says('shape = "file" file = "no_such_file.h5" operation = "subtract"', &
                   'operation = "subtract"; particles of a file can only be added'//nl// &
                   'line 6: &body: file = "no_such_file.h5"; there is no such file')
    call body_says('shape = "sphere" center = 2*0.5 radius = 0.1 fill = "polar" radial_particles = 2 angular_particles = 8', "")
    call body_says('shape = "cylinder" center = 2*0.5 radius = 0.1 fill = "polar" radial_particles = 2 angular_particles = 8', &
                   'fill = "polar"; polar particles are for a ring or sphere in 2D, not for a cylinder in 2D')
    call body_says('shape = "sphere" center = 2*0.5 radius = 0.1 initial = "verification"', &
                   'initial = "verification"; needs a group &verification')
  end subroutine test_bodies

  subroutine polygon_says(points, expected)
    character(len=*), intent(in) :: points, expected
    if (expected == "") call body_says('shape = "polygon" points = '//points, "")
    if (expected /= "") call body_says('shape = "polygon" points = '//points, "points = "//points//"; "//expected)
  end subroutine polygon_says

  subroutine test_polygons()
    call polygon_says("0, 0, 1, 0, 0, 1", "")
    call polygon_says("0, 0, 0, 1, 1, 1, 1, 0", "")
    call polygon_says("0, 0, 2, 0, 2, 2, 1, 1, 0, 2", "")
    call polygon_says("0, 0, 1, 0, 2, 0, 2, 2", "")
    call polygon_says("0, 0, 1, 1", "has 2 corners; a polygon needs at least 3")
    call polygon_says("0, 0, 1, 0, 1, 0, 0, 1", "corners 2 and 3 are the same point")
    call polygon_says("0, 0, 1, 0, 0, 1, 0, 0", "corners 4 and 1 are the same point")
    call polygon_says("0, 0, 1, 1, 1, 0, 0, 1", "edges 1 and 3 cross or touch; a polygon must not cross itself")
    call polygon_says("0, 0, 2, 0, 2, 2, 1, 0, 0, 2", "edges 1 and 3 cross or touch; a polygon must not cross itself")
    call polygon_says("0, 0, 1, 1, 2, 2", "all corners lie on one line")
  end subroutine test_polygons

  subroutine test_boundaries_and_loads()
    character(len=*), parameter :: moving = '&boundary side = "x_low" condition = "velocity" velocity = 1, 0 '
    call extra_says('&boundary side = "x_low" condition = "periodic" / &boundary side = "x_high" condition = "periodic" /', "")
    call extra_says('&boundary side = "all" condition = "periodic" /', "")
    call extra_says('&boundary side = "y_high" condition = "periodic" /', &
                    '&boundary: condition = "periodic"; the side across, y_low, must be periodic too')
    call extra_says('&boundary side = "z_high" condition = "slip" /', &
                    '&boundary: side = "z_high"; a scene of dimension 2 has no such side')
    call extra_says('&boundary side = "x_low" condition = "slip" / &boundary side = "all" condition = "slip" /', &
                    '&boundary: side = "all"; this side has a condition already, from line 6')
    call extra_says('&boundary side = "x_low" condition = "velocity" /', "&boundary: velocity is not set; a number [m/s] is wanted")
    call extra_says(moving//'times = 0, 1 factors = 0, 1 /', "")
    call extra_says(moving//'times = 0, 1 /', "&boundary: times = 0, 1; needs factors as well")
    call extra_says(moving//'factors = 0, 1 /', "&boundary: factors = 0, 1; needs times as well")
    call extra_says(moving//'times = 0, 0 factors = 0, 1 /', "&boundary: times = 0, 0; must increase; 0 follows 0")
    call extra_says(moving//'times = 0, 1 factors = 3*1 /', "&boundary: factors = 1, 1, 1; has 3 values for 2 times; "// &
                    "as many are wanted")
    call extra_says('&load kind = "traction" body = "block" traction = 1, 0 face = "x_high" ramp_time = 1 /', "")
    call extra_says('&load kind = "traction" body = "block" traction = 1, 0 face = "z_high" /', &
                    '&load: face = "z_high"; a scene of dimension 2 has no such side')
    call extra_says('&load kind = "point_force" body = "blck" force = 1, 0 point = 2*0.5 /', &
                    '&load: body = "blck"; no &body has this name; did you mean "block"?')
    call extra_says('&load kind = "gravity" acceleration = 0, -10 body = "block" /', &
                    '&load: body = "block"; is not read by kind gravity, only by traction, pressure or point_force')
    call extra_says('&load kind = "pressure" body = "hole" pressure = 1 face = "all" / &body name = "hole" shape = "sphere" '// &
                    'operation = "subtract" center = 2*0.5 radius = 0.1 /', &
                    '&load: body = "hole"; this body is subtracted and has no particles')
  end subroutine test_boundaries_and_loads

  subroutine test_time_and_output()
    call time_says('step_rule = "uniform" steps = 10', "")
    call time_says('step_rule = "uniform" steps = 10 courant = 0.5', &
                   "courant = 0.5; cannot stand together with steps; give one of the two")
    call time_says('step_rule = "fixed" step = 0.1', "")
    call time_says('step_rule = "fixed" step = 0.1 courant = 0.5', &
                   "courant = 0.5; is not read by step_rule fixed, only by adaptive or uniform")
    call time_says('step_rule = "fixed" step = 2', "step = 2; must be at most end = 1")
    call time_says('steps = 10', "steps = 10; is not read by step_rule adaptive, only by uniform")
    call time_says('growth = 0.9', "growth = 0.9; must be at least 1")
    call extra_says('&output name = "no_such_folder/a" /', &
                    '&output: name = "no_such_folder/a"; there is no folder no_such_folder/; make it first')
    call extra_says('&output name = "./a" /', "")
    call extra_says('&output name = "a/" /', '&output: name = "a/"; must end with the name of a file, not of a folder')
    call extra_says('&output name = "a.vtkhdf" /', '&output: name = "a.vtkhdf"; is written without .vtkhdf, which is added')
    call extra_says('&output fields = "error" /', '&output: fields = "error"; "error" needs a group &verification')
    call test_existing_output()
  end subroutine test_time_and_output

  subroutine test_existing_output()
    integer :: unit
    open (newunit=unit, file="test_scene_taken.vtkhdf", status="replace")
    call extra_says('&output name = "test_scene_taken" /', '&output: name = "test_scene_taken"; test_scene_taken.vtkhdf '// &
                    "exists; choose another name or set overwrite = .true.")
    call extra_says('&output name = "test_scene_taken" overwrite = .true. /', "")
    close (unit, status="delete")
  end subroutine test_existing_output

  !> A mistake that spoils what others need is told alone
  subroutine test_one_slip_one_message()
    call says("&scene dimension = two /"//head(index(head, nl):)//rubber//block//finish, &
              'line 1: &scene: dimension = two; "two" is not a whole number; a whole number between 1 and 3 is wanted')
    call says(head//'&material name = "rubber" model = "neo" yield_stress = 3'//elastic//' /'//nl//block//finish, &
              'line 3: &material: model = "neo"; there is no such word; known: neo_hookean, linear_elastic, hencky, '// &
              "hencky_von_mises, drucker_prager")
    call says(head//'&material name = rubber model = "neo_hookean"'//elastic//' /'//nl//block//finish, &
              'line 3: &material: name = rubber; words and texts stand in quotes: "rubber"')
    call says(head//block//finish, "&material: the group is missing (a material that bodies name; one group each)")
    call says("&scene dimension = 2 /"//nl//"&grid lower = 2*0 upper = 1, inf spacing = 0.1 /"//nl//rubber//block//finish, &
              "line 2: &grid: upper = 1, inf; inf is not a finite number; a number [m] is wanted")
  end subroutine test_one_slip_one_message

end program test_scene_mistakes
