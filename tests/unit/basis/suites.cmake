gimp_add_unit_test(basis test_basis SINGLE)
gimp_add_unit_test(basis test_domains)
gimp_add_unit_test(basis test_splines)
gimp_add_unit_test(basis test_point_domains)
