defmodule Situ.Argument do
  @moduledoc false
  # The one home of the texts with which a public function refuses an argument. They say what it takes, what it was
  # given and what to write.
  alias Situ.Graph.Handle
  alias Situ.{Node, Stream}

  @typedoc """
  The kind that a function takes: a stream, a pipeline that is being built, one that runs, a function that builds one, a
  node, or something else in words.
  """
  @type kind :: :stream | :streams | :handle | :target | :build | :node | String.t()

  @doc "Raises an `ArgumentError`; `example` shows the call as it should be."
  @spec refuse!(term(), kind(), String.t()) :: no_return()
  def refuse!(value, kind, example) do
    raise ArgumentError,
          "#{function(example)} takes #{wanted(kind)}, not #{given(value)}; " <>
            hint(value, kind, example)
  end

  @doc "The stream itself; raises for anything else."
  @spec stream!(term(), String.t()) :: Stream.t()
  def stream!(%Stream{} = stream, _example), do: stream
  def stream!(value, example), do: refuse!(value, :stream, example)

  defp function(example), do: example |> String.split("(") |> hd()

  defp wanted(:stream), do: "a stream as its first argument, and arguments as in #{sees()}"
  defp wanted(:streams), do: "streams, and arguments as in #{sees()}"
  defp wanted(:handle), do: "a pipeline that is being built, and arguments as in #{sees()}"

  defp wanted(:target),
    do: "a running pipeline (its handle, process or name) or one of its streams"

  defp wanted(:build), do: "a function that builds a pipeline"
  defp wanted(:node), do: "a node, as Situ.Pipeline.add/3 returns it"
  defp wanted(text), do: text

  defp sees, do: "its documentation"

  defp given(%Handle{}), do: "a pipeline (the p of build)"
  defp given(%Stream{}), do: "a stream and what came with it"
  defp given(%Node{path: path}), do: "the node #{path}"
  defp given(%_{snapshot: _}), do: "the report of a pipeline that has ended"
  defp given({:ok, value}), do: "{:ok, ...} with #{given(value)}"
  defp given(%module{}), do: "a %#{inspect(module)}{}"
  defp given(%{} = map) when map_size(map) > 0, do: map(map)
  defp given([_ | _]), do: "a list"
  defp given(fun) when is_function(fun), do: "a function"
  defp given(pid) when is_pid(pid), do: "a process"
  defp given(other), do: inspect(other, limit: 5, printable_limit: 60)

  defp map(map) do
    if Enum.all?(map, &match?({_, %Stream{}}, &1)),
      do: "a map of streams (#{map |> Map.keys() |> Enum.map_join(", ", &inspect/1)})",
      else: "a map"
  end

  defp hint(%Handle{}, kind, example) when kind in [:stream, :streams],
    do: "add a source first, and use its stream: stream = Situ.source(p, Camera), then #{example}"

  defp hint(%{} = map, kind, example) when kind in [:stream, :streams] and not is_struct(map),
    do: "take one of its streams, as in stream = streams.#{output(map)}, then #{example}"

  defp hint(%Node{}, kind, example) when kind in [:stream, :streams],
    do: "take one of its outputs: stream = Situ.Node.output(node, :out), then #{example}"

  defp hint(%Stream{}, :handle, example),
    do: "a stream knows its pipeline: p = stream.pipeline, then #{example}"

  defp hint(pid, :handle, example) when is_pid(pid),
    do: "what runs is extended: Situ.Pipeline.extend(pid, fn p -> #{example} end)"

  defp hint({:ok, _}, _kind, example),
    do: "take it out first: {:ok, value} = ..., then #{example}"

  defp hint(%_{snapshot: _}, :target, _example),
    do: "print what it was like with IO.puts(Situ.Diagnostics.format(report.snapshot))"

  defp hint(fun, :target, example) when is_function(fun),
    do: "start it first: {:ok, p} = Situ.Pipeline.start(build), then #{example}"

  defp hint(_value, :target, example),
    do: "write {:ok, p} = Situ.Pipeline.start(build), then #{example}"

  defp hint(_value, :build, example), do: "write #{example}"
  defp hint(_value, _kind, example), do: "write #{example}"

  defp output(map), do: map |> Map.keys() |> hd() |> to_string()
end
