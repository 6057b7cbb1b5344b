defmodule Situ.Store.Csv.FieldTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Store.Csv.Field

  test "strings that look like numbers are numbers" do
    for {text, value} <- [{"5", 5}, {"-5", -5}, {"5.0", 5.0}, {"1.0e3", 1.0e3}],
        do: assert(Field.parse_value(text) === value)

    for text <- ["", "5 m", "0x5", "nan", "5,0"], do: assert(Field.infer_kind(text) == :string)
  end

  test "a column has the type of all its fields" do
    unified = fn kinds -> Enum.reduce(kinds, nil, &Field.merge_kinds(&2, &1)) end
    assert unified.([:integer, :integer]) == :integer
    assert unified.([:integer, :float]) == :float
    assert unified.([:float, :integer]) == :float
    assert unified.([:integer, :string, :float]) == :string
    assert Field.parse_as("5", :float) === 5.0 and Field.parse_as("5", :string) === "5"
  end

  property "unifying does not depend on the order" do
    forall kinds <- nonempty_list(one_of([:integer, :float, :string])) do
      unified = fn kinds -> Enum.reduce(kinds, nil, &Field.merge_kinds(&2, &1)) end
      unified.(kinds) == unified.(Enum.reverse(kinds))
    end
  end

  test "takes the unit from the name, the value or the option" do
    assert Field.resolve_unit("time", "2024-01-01T00:00:00Z", :auto) == {:ok, :iso8601}

    for {name, unit} <- [
          {"t", :s},
          {"t_ms", :ms},
          {"time (us)", :us},
          {"t [µs]", :us},
          {"t_ns", :ns}
        ],
        do: assert(Field.resolve_unit(name, "5", :auto) == {:ok, unit})

    assert Field.resolve_unit("t_ms", nil, :auto) == {:ok, :s}
    assert Field.resolve_unit("t_ms", "5", :ns) == {:ok, :ns}
    assert {:error, why} = Field.resolve_unit("t", "5", :min)
    assert why =~ ":min"
  end

  test "whole times are exact" do
    assert Field.parse_time("1700000000", :s) == {:ok, 1_700_000_000_000_000_000}
    assert Field.parse_time(" 1.5 ", :ms) == {:ok, 1_500_000}
    assert Field.parse_time("1970-01-01T00:00:01Z", :iso8601) == {:ok, 1_000_000_000}
    assert Field.parse_time("soon", :s) =~ "soon"
    assert is_binary(Field.parse_time("soon", :iso8601))
  end
end
