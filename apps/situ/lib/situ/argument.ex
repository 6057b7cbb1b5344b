defmodule Situ.Argument do
  @moduledoc false
  # The errors of public functions that were called with an invalid argument. Each error names the expected argument,
  # the given value and the code to write instead.
  alias Situ.Graph.Handle
  alias Situ.{Node, Stream}

  @typedoc """
  The kind of argument that a function expects: a stream, streams, a pipeline that is being built, a running pipeline,
  a function that builds a pipeline, a node, or a description in words.
  """
  @type kind :: :stream | :streams | :handle | :target | :build | :node | String.t()

  @doc """
  Raises an `ArgumentError`; `example` shows a correct call.

  If `value` is of the expected kind, the error says that the arguments after it are invalid.
  """
  @spec raise_invalid!(term(), kind(), String.t()) :: no_return()
  def raise_invalid!(value, kind, example),
    do:
      raise(ArgumentError, "#{function_name(example)} #{describe_mistake(value, kind, example)}")

  @doc "Returns the stream unchanged; raises for any other value."
  @spec ensure_stream!(term(), String.t()) :: Stream.t()
  def ensure_stream!(%Stream{} = stream, _example), do: stream
  def ensure_stream!(value, example), do: raise_invalid!(value, :stream, example)

  defp function_name(example), do: example |> String.split("(") |> hd()

  defp describe_mistake(value, kind, example) do
    if of_kind?(value, kind),
      do: "does not take these arguments after the first; write #{example}",
      else:
        "takes #{describe_kind(kind)}, not #{describe_value(value)}; " <>
          suggest_fix(value, kind, example)
  end

  defp of_kind?(%Stream{}, kind) when kind in [:stream, :streams], do: true
  defp of_kind?(%Handle{}, :handle), do: true
  defp of_kind?(_value, _kind), do: false

  defp describe_kind(:stream), do: "a stream as its first argument"
  defp describe_kind(:streams), do: "streams"
  defp describe_kind(:handle), do: "a pipeline that is being built"

  defp describe_kind(:target),
    do: "a running pipeline (its handle, process or name) or one of its streams"

  defp describe_kind(:build), do: "a function that builds a pipeline"
  defp describe_kind(:node), do: "a node, as Situ.Pipeline.add/3 returns it"
  defp describe_kind(text), do: text

  defp describe_value(%Handle{}), do: "a pipeline (the p of build)"
  defp describe_value(%Stream{}), do: "a stream"
  defp describe_value(%Node{path: path}), do: "the node #{path}"
  defp describe_value(%_{snapshot: _}), do: "the report of a pipeline that has ended"
  defp describe_value({:ok, value}), do: "{:ok, ...} with #{describe_value(value)}"
  defp describe_value(%module{}), do: "a %#{inspect(module)}{}"
  defp describe_value(%{} = map) when map_size(map) > 0, do: describe_map(map)
  defp describe_value([_ | _]), do: "a list"

  defp describe_value(fun) when is_function(fun),
    do: "a function of arity #{fun |> Function.info(:arity) |> elem(1)}"

  defp describe_value(pid) when is_pid(pid), do: "a process"
  defp describe_value(other), do: inspect(other, limit: 5, printable_limit: 60)

  defp describe_map(map) do
    if Enum.all?(map, &match?({_, %Stream{}}, &1)),
      do: "a map of streams (#{map |> Map.keys() |> Enum.map_join(", ", &inspect/1)})",
      else: "a map"
  end

  defp suggest_fix(%Handle{}, kind, example) when kind in [:stream, :streams],
    do: "add a source and use its stream: stream = Situ.source(p, Camera), then #{example}"

  defp suggest_fix(%{} = map, kind, example)
       when kind in [:stream, :streams] and not is_struct(map),
       do: "take one of its streams, as in stream = streams.#{first_key(map)}, then #{example}"

  defp suggest_fix(%Node{}, kind, example) when kind in [:stream, :streams],
    do: "take one of its outputs: stream = Situ.Node.output(node, :out), then #{example}"

  defp suggest_fix(%Stream{}, :handle, example),
    do: "use the pipeline of the stream: p = stream.pipeline, then #{example}"

  defp suggest_fix(pid, :handle, example) when is_pid(pid),
    do: "extend a running pipeline with Situ.Pipeline.extend(pid, fn p -> #{example} end)"

  defp suggest_fix({:ok, _}, _kind, example),
    do: "take it out first: {:ok, value} = ..., then #{example}"

  defp suggest_fix(%_{snapshot: _}, :target, _example),
    do: "print the report with IO.puts(Situ.Diagnostics.format(report.snapshot))"

  defp suggest_fix(fun, :target, example) when is_function(fun),
    do: "start it first: {:ok, p} = Situ.Pipeline.start(build), then #{example}"

  defp suggest_fix(_value, :target, example),
    do: "write {:ok, p} = Situ.Pipeline.start(build), then #{example}"

  defp suggest_fix(_value, _kind, example), do: "write #{example}"

  defp first_key(map), do: map |> Map.keys() |> hd() |> to_string()
end
