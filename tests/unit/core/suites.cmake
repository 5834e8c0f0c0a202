gimp_add_unit_test(core test_tensor SINGLE)
gimp_add_unit_test(core test_tensor_functions SINGLE)
