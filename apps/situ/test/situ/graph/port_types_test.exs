defmodule Situ.Graph.PortTypesTest do
  use ExUnit.Case, async: true

  defmodule Pairs do
    use Situ.Component, inputs: [in: {:tuple, [{:optional, :integer}, :integer]}]

    @impl true
    def init(_opts), do: {:ok, 0}

    @impl true
    def handle_message(:in, %{data: {a, b}}, _context, sum), do: {[], sum + (a || 0) + b}
  end

  test "a tuple type with an optional element is a type, not the port's options" do
    assert {:ok, %{errors: []}} =
             Situ.Pipeline.run(fn p ->
               pairs = Situ.from_enumerable(p, [{nil, 1}, {2, 3}], every: 1)
               node = Situ.Pipeline.add(p, Pairs)
               assert node.inputs == [in: {:tuple, [{:optional, :integer}, :integer]}]
               Situ.Pipeline.connect(pairs, node, :in)
             end)
  end
end
