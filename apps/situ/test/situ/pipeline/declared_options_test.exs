defmodule Situ.Pipeline.DeclaredOptionsTest do
  use ExUnit.Case, async: true
  alias Situ.Pipeline

  defmodule Counter do
    @moduledoc "Counts."
    use Situ.Pipeline,
      options: [
        count: [type: :pos_integer, default: 2, doc: "How many numbers."],
        to: [type: :pid, required: true, doc: "The process that receives them."]
      ]

    @impl true
    def build(p, opts) do
      p |> Situ.from_enumerable(1..opts[:count], every: 1) |> Situ.each(&send(opts[:to], &1))
      opts
    end
  end

  defmodule Undeclared do
    @moduledoc false
    use Situ.Pipeline
    @impl true
    def build(_p, opts), do: opts
  end

  test "defaults are filled in before build/2 is called" do
    assert {:ok, %{result: [count: 2, to: pid]}} = Pipeline.run(Counter, to: self())
    assert pid == self()
    assert_received 2
    refute_received 3
  end

  test "every way to start refuses invalid options, and starts nothing" do
    for start <- [&Pipeline.run/2, &Pipeline.start/2, &Pipeline.start_link/2] do
      assert {:error, %{code: :unknown_option}} = start.(Counter, to: self(), cuont: 3)
      assert {:error, %{code: :bad_option}} = start.(Counter, to: self(), count: "3")
      assert {:error, %{code: :missing_option}} = start.(Counter, count: 3)
    end

    refute_received 1
  end

  test "settings of the pipeline are not options of the module" do
    assert {:ok, %{name: "Two"}} = Pipeline.run(Counter, to: self(), pipeline: [name: "Two"])
  end

  test "a module without a schema receives any options" do
    assert {:ok, %{result: [anything: 1]}} = Pipeline.run(Undeclared, anything: 1)
    refute function_exported?(Undeclared, :options, 0)
  end

  test "lists the streams that were named explicitly, in the order of construction" do
    {:ok, report} =
      Pipeline.run(fn p ->
        numbers = Situ.from_enumerable(p, 1..2, every: 1)
        doubled = numbers |> Situ.map(&(&1 * 2)) |> Situ.name("Doubled")
        Situ.composite(doubled, "Side", fn s -> Situ.map(s, & &1, name: "Same") end)
        {Pipeline.stream_names(p), Pipeline.stream_names(p, :named)}
      end)

    assert report.result ==
             {["Enumerable", "Doubled", "Side.Same"], ["Doubled", "Side.Same"]}
  end

  describe "settings in the wrong place" do
    test "are refused for a function, with the right place" do
      build = fn _p -> flunk("must not be built") end

      for launch <- [&Pipeline.run/2, &Pipeline.start/2, &Pipeline.start_link/2] do
        assert {:error, error} = launch.(build, name: "Hall")
        assert {error.code, error.fix} == {:unknown_option, ~s(write pipeline: [name: "Hall"])}
        assert error.why == ":name is a setting of the pipeline"
      end

      assert {:error, error} = Pipeline.run(build, pipeline: [name: "Hall"], threshold: 1)
      assert error.what == "unknown option :threshold"
      assert error.fix =~ "no options"
      assert {:error, %{fix: fix}} = Pipeline.run(build, pipeline: [nme: "Hall"])
      assert fix =~ "did you mean :name?"
    end

    test "are refused for a module with declared options" do
      assert {:error, error} = Pipeline.run(Counter, to: self(), spede: 2)
      assert error.code == :unknown_option
      assert {:error, error} = Pipeline.run(Counter, to: self(), max_restarts: 1)
      assert error.fix == "write pipeline: [max_restarts: 1]"
    end
  end
end
