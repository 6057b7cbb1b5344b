defmodule Situ.Store.Csv.FieldTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Store.Csv.Field

  test "texts that look like numbers are" do
    for {text, value} <- [{"5", 5}, {"-5", -5}, {"5.0", 5.0}, {"1.0e3", 1.0e3}],
        do: assert(Field.value(text) === value)

    for text <- ["", "5 m", "0x5", "nan", "5,0"], do: assert(Field.kind(text) == :string)
  end

  test "a column is what all of its fields are" do
    unified = fn kinds -> Enum.reduce(kinds, nil, &Field.unify(&2, &1)) end
    assert unified.([:integer, :integer]) == :integer
    assert unified.([:integer, :float]) == :float
    assert unified.([:float, :integer]) == :float
    assert unified.([:integer, :string, :float]) == :string
    assert Field.as("5", :float) === 5.0 and Field.as("5", :string) === "5"
  end

  property "unifying does not depend on the order" do
    forall kinds <- nonempty_list(one_of([:integer, :float, :string])) do
      unified = fn kinds -> Enum.reduce(kinds, nil, &Field.unify(&2, &1)) end
      unified.(kinds) == unified.(Enum.reverse(kinds))
    end
  end

  test "units by name, by look, or as asked for" do
    assert Field.unit("time", "2024-01-01T00:00:00Z", :auto) == {:ok, :iso8601}

    for {name, unit} <- [
          {"t", :s},
          {"t_ms", :ms},
          {"time (us)", :us},
          {"t [µs]", :us},
          {"t_ns", :ns}
        ],
        do: assert(Field.unit(name, "5", :auto) == {:ok, unit})

    assert Field.unit("t_ms", nil, :auto) == {:ok, :s}
    assert Field.unit("t_ms", "5", :ns) == {:ok, :ns}
    assert {:error, why} = Field.unit("t", "5", :min)
    assert why =~ ":min"
  end

  test "times are exact where they are whole" do
    assert Field.time("1700000000", :s) == {:ok, 1_700_000_000_000_000_000}
    assert Field.time(" 1.5 ", :ms) == {:ok, 1_500_000}
    assert Field.time("1970-01-01T00:00:01Z", :iso8601) == {:ok, 1_000_000_000}
    assert Field.time("soon", :s) =~ "soon"
    assert is_binary(Field.time("soon", :iso8601))
  end
end
