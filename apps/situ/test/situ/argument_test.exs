defmodule Situ.ArgumentTest do
  # Covers beginners' mistakes: the error names the expected and the given argument, and shows the correct call.
  use ExUnit.Case, async: true

  alias Situ.{Pipeline, Stream}
  alias Situ.Graph.Handle

  # These functions take no pipeline or stream as first argument, or take any term.
  @others [
    {Pipeline, :child_spec},
    {Pipeline, :list},
    {Pipeline, :new},
    {Pipeline, :run},
    {Pipeline, :start},
    {Pipeline, :start_link}
  ]

  defp handle, do: %Handle{pid: self(), ref: make_ref()}
  defp stream, do: %Stream{pipeline: handle(), node: 1, output: :out, name: "s"}

  defp report do
    {:ok, report} = Pipeline.run(fn _p -> :ok end)
    report
  end

  # Lists every public function of the facade, of pipelines and of streams, with every arity.
  defp functions do
    for module <- [Situ, Pipeline, Stream],
        {name, arity} <- module.__info__(:functions),
        arity > 0,
        {module, name} not in @others,
        not String.starts_with?(Atom.to_string(name), "__"),
        do: {module, name, arity}
  end

  # Most functions take a stream; some take a handle or a report.
  defp wrong(report), do: [nil, 42, "", %{}, %{a: 1}, {:ok, self()}, {:a, :b, :c}, ["x"], report]

  test "no public function raises a FunctionClauseError, whatever its first argument is" do
    all = functions()
    assert length(all) > 110
    report = report()

    assert [] =
             for(
               {module, name, arity} <- all,
               first <- wrong(report),
               slip = slip({module, name, arity}, first),
               do: slip
             )
  end

  test "a pipeline in place of a stream, or a stream in place of a pipeline, raises a helpful error" do
    assert [] =
             for(
               {module, name, arity} <- functions(),
               module in [Situ, Stream],
               first <- [handle(), stream()],
               slip = slip({module, name, arity}, first),
               do: slip
             )
  end

  # Returns an error whose message does not say what to write. The process of the handle may refuse the other
  # arguments.
  defp slip({module, name, arity}, first) do
    apply(module, name, [first | List.duplicate([], arity - 1)])
    nil
  rescue
    error in [ArgumentError, Situ.Error] ->
      if Exception.message(error) == "argument error", do: {module, name, arity, first}

    error ->
      {module, name, arity, first, Exception.message(error) |> String.slice(0, 200)}
  catch
    :exit, _ -> nil
  end

  defp message(fun), do: fun |> assert_raised() |> Exception.message()

  defp assert_raised(fun) do
    fun.()
    flunk("nothing was raised")
  rescue
    error in ArgumentError -> error
  end

  test "the error says what to write" do
    assert message(fn -> Situ.map(handle(), & &1) end) =~
             ~r/^Situ.map takes a stream .*, not a pipeline .*Situ.source\(p, Camera\), then Situ.map\(stream/

    assert message(fn -> Situ.via(handle(), Some.Component) end) =~
             "Situ.via(stream, Some.Component)"

    assert message(fn -> Situ.source(stream(), Camera) end) =~ "stream.pipeline"
    assert message(fn -> Situ.map(%{left: stream()}, & &1) end) =~ "stream = streams.left"
    assert message(fn -> Situ.inspect(report()) end) =~ "Situ.Diagnostics.format(report.snapshot)"
    assert message(fn -> Situ.inspect(fn p -> p end) end) =~ "Situ.Pipeline.start(build)"
    assert message(fn -> Pipeline.info({:ok, self()}) end) =~ "take it out first"

    assert message(fn -> Situ.scan(stream(), 0, :not_a_function) end) =~
             ~r/^Situ.scan does not take these arguments after the first; write Situ.scan\(stream, 0/

    assert message(fn -> Situ.to_list(fn -> :ok end) end) =~ "not a function of arity 0"
    assert message(fn -> Situ.to_list(stream()) end) =~ "a function that builds a pipeline"
    assert message(fn -> Pipeline.remove(self(), :side) end) =~ ~s|(p, "Side")|
  end

  test "a misspelled policy name suggests the nearest one" do
    build = fn policy ->
      fn p -> p |> Situ.from_enumerable([], every: 1) |> Situ.map(& &1, policy: policy) end
    end

    for {policy, fix} <- [
          latest: "did you mean Situ.Delivery.latest()?",
          lastest: "did you mean Situ.Delivery.latest()?",
          trottle: "did you mean Situ.Delivery.throttle()?"
        ] do
      assert {:error, %{code: :bad_option, fix: ^fix}} = Pipeline.run(build.(policy))
    end

    assert {:error, %{fix: "did you mean Situ.Delivery.max_queue(5)?"}} =
             Pipeline.run(build.({:max_queue, 3}))
  end
end
