defmodule Situ.Options.ParsingTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Options

  @schema [
    gap: [type: :time_ns, default: 0],
    stream: [type: :string, default: "Audio"],
    quality: [type: {:integer, 1, 100}, default: 90],
    gain: [type: :float, default: 1.0],
    mode: [type: {:in, [:fast, :exact]}, default: :fast],
    drop: [type: {:list, :string}, default: []],
    least: [type: {:optional, :float}]
  ]

  test "converts JSON values to the types of the options" do
    config = %{"mode" => "exact", "gain" => 2, "drop" => "Secret", "least" => 1}
    assert {:ok, opts} = Options.parse(config, @schema)
    assert opts[:mode] == :exact and opts[:drop] == ["Secret"] and opts[:stream] == "Audio"
    assert opts[:gain] === 2.0 and opts[:least] === 1.0
    assert {:ok, [_, _, {:quality, 80} | _]} = Options.parse(%{"quality" => 80.0}, @schema)
    assert {:error, %{code: :bad_option}} = Options.parse(%{"quality" => 80.5}, @schema)
    assert {:ok, [{:gap, 200_000_000} | _]} = Options.parse(%{"gap" => "200ms"}, @schema)
    assert {:error, %{code: :bad_option}} = Options.parse(%{"gap" => "soon"}, @schema)
  end

  property "accepts any configuration as valid options, or returns an error" do
    value =
      one_of([
        integer(),
        float(),
        boolean(),
        ascii_text(),
        list(ascii_text()),
        one_of([nil, %{}, "exact"])
      ])

    name = one_of(["gap", "stream", "quality", "gain", "mode", "drop", "least", ascii_text()])

    forall pairs <- list({name, value}) do
      case Options.parse(Map.new(pairs), @schema) do
        {:ok, opts} ->
          assert opts[:quality] in 1..100 and opts[:mode] in [:fast, :exact]
          assert is_float(opts[:gain]) and is_list(opts[:drop])

        {:error, %Situ.Error{code: code}} ->
          assert code in [:unknown_option, :bad_option]
      end
    end
  end

  test "unknown names create no atoms" do
    unknown = fn n ->
      {:error, %{code: :unknown_option}} = Options.parse(%{"strange#{n}" => "mode#{n}"}, @schema)
    end

    unknown.(0)
    before = :erlang.system_info(:atom_count)
    for n <- 1..1_000, do: unknown.(n)
    # Other tests run in parallel.
    assert :erlang.system_info(:atom_count) - before < 500
  end
end
