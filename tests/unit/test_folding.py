"""What is known while code is made takes no instructions; what is put together is, where used."""

from __future__ import annotations

import ctypes
import operator

import pytest
from llvmlite import binding, ir

from exwarp_cli.compiled import builds  # has instructions left out
from exwarp_cli.compiled.folding import COMPARISONS, known
from exwarp_cli.compiled.structures import Whole, write_chosen

BYTE, WIDE, BIT = ir.IntType(8), ir.IntType(64), ir.IntType(1)
PAIR = ir.LiteralStructType([WIDE, ir.ArrayType(WIDE, 2)])


@pytest.fixture
def builder() -> ir.IRBuilder:
    assert builds.knows_inside()
    kind = ir.FunctionType(WIDE, [WIDE, BIT])
    function = ir.Function(ir.Module(), kind, "made")
    return ir.IRBuilder(function.append_basic_block())


def result(builder: ir.IRBuilder, *given: int) -> int:
    """Compile what was made, and run it."""
    write_chosen(builder.function)
    module = binding.parse_assembly(str(builder.module))
    module.verify()
    target = binding.Target.from_default_triple().create_target_machine()
    with binding.create_mcjit_compiler(module, target) as engine:
        engine.finalize_object()
        address = engine.get_function_address("made")
        return ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, ctypes.c_bool)(address)(*given)


class TestNumbers:
    @pytest.mark.parametrize("name", ["add", "sub", "mul"])
    def test_they_wrap_as_those_of_processors(self, builder, name):
        for a in (-128, -3, 0, 1, 5, 127, 200):
            for b in (-128, -1, 0, 1, 7, 127, 255):
                found = known(getattr(builder, name)(BYTE(a), BYTE(b)))
                assert found is not None and -128 <= found < 128
                assert (found - getattr(operator, name)(a, b)) % 256 == 0
        assert not builder.block.instructions

    def test_what_changes_nothing_is_left_out(self, builder):
        value, _ = builder.function.args
        for same in (
            builder.add(value, WIDE(0)),
            builder.add(WIDE(0), value),
            builder.sub(value, WIDE(0)),
            builder.mul(value, WIDE(1)),
            builder.mul(WIDE(1), value),
        ):
            assert same is value
        builder.ret(builder.sub(WIDE(0), builder.add(value, WIDE(1))))
        assert result(builder, 4, 0) == -5

    @pytest.mark.parametrize("how", COMPARISONS)
    def test_they_are_compared_with_their_signs(self, builder, how):
        for a, b in ((-1, 1), (255, 1), (2, 2), (5, -128)):
            signed = [(number + 128) % 256 - 128 for number in (a, b)]
            assert known(builder.icmp_signed(how, BYTE(a), BYTE(b))) == COMPARISONS[how](*signed)
        assert not builder.block.instructions

    def test_a_choice_is_made_at_once(self, builder):
        value, which = builder.function.args
        assert builder.select(BIT(1), value, WIDE(3)) is value
        assert known(builder.select(BIT(0), value, WIDE(3))) == 3
        builder.ret(builder.select(which, value, WIDE(3)))
        assert result(builder, 8, 1) == 8 and result(builder, 8, 0) == 3

    @pytest.mark.parametrize("value", [ir.Constant(WIDE, ir.Undefined), ir.Constant(PAIR, None)])
    def test_of_others_nothing_is_known(self, value):
        assert known(value) is None


class TestWholes:
    def test_their_parts_are_taken_as_they_are(self, builder):
        value, _ = builder.function.args
        whole = builder.insert_value(ir.Constant(PAIR, None), value, [1, 0])
        whole = builder.insert_value(whole, WIDE(7), 0)
        assert builder.extract_value(whole, [1, 0]) is value
        assert known(builder.extract_value(whole, 0)) == 7
        inner = builder.extract_value(whole, 1)
        assert type(inner) is Whole and builder.extract_value(inner, 0) is value

    def test_they_are_put_together_where_they_are_used(self, builder):
        value, _ = builder.function.args
        place = builder.alloca(PAIR)
        whole = builder.insert_value(ir.Constant(PAIR, None), value, [1, 1])
        assert len(builder.block.instructions) == 1
        builder.store(builder.insert_value(whole, WIDE(7), 0), place)
        read = builder.load(place)
        first = builder.extract_value(read, 0)
        builder.ret(builder.mul(first, builder.extract_value(read, [1, 1])))
        assert result(builder, 6, 0) == 42

    def test_one_may_be_chosen_by_where_it_comes_from(self, builder):
        value, which = builder.function.args
        with builder.if_else(which) as (then, otherwise):
            with then:
                one = builder.insert_value(ir.Constant(PAIR, None), value, 0)
                begin = builder.block
            with otherwise:
                other = builder.insert_value(ir.Constant(PAIR, None), WIDE(9), 0)
                end = builder.block
        chosen = builder.phi(PAIR)
        chosen.add_incoming(one, begin)
        chosen.add_incoming(other, end)
        builder.ret(builder.extract_value(chosen, 0))
        assert result(builder, 5, 1) == 5 and result(builder, 5, 0) == 9

    def test_parts_have_their_kinds(self, builder):
        with pytest.raises(AssertionError):
            builder.insert_value(ir.Constant(PAIR, None), BYTE(1), 0)
