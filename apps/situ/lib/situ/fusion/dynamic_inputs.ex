defmodule Situ.Fusion.DynamicInputs do
  @moduledoc false
  # Asks a running pipeline to add an input to a fusion operator, or to remove one.
  alias Situ.{Argument, Error, Options, Pipeline, Stream}

  @policy [policy: [type: {:struct, Situ.Delivery}]]

  @spec add_input(term(), term(), Stream.t() | String.t(), keyword()) ::
          {:ok, Situ.Time.t() | :start} | {:error, Error.t()}
  def add_input(fused, key, stream, opts) do
    {policy, request} = Keyword.split(opts, [:policy])
    policy = Options.validate!(policy, @policy)[:policy]
    {pipeline, taker} = locate_operator(fused)
    from = locate_stream(pipeline, stream)

    request = %{
      taker: taker,
      stream: from,
      policy: policy,
      request: {key, request},
      input: &input_name/1
    }

    Pipeline.Client.call(pipeline, {:attach, request})
  end

  @spec remove_input(term(), term(), keyword()) ::
          {:ok, Situ.Time.t() | :start} | {:error, Error.t()}
  def remove_input(fused, key, opts) do
    {pipeline, taker} = locate_operator(fused)
    Pipeline.Client.call(pipeline, {:detach, %{taker: taker, request: {key, opts}}})
  end

  defp input_name(index), do: :"s#{index}"

  defp locate_operator(%Stream{} = stream), do: {stream.pipeline, {stream.node, stream.output}}
  defp locate_operator({pipeline, name}) when is_binary(name), do: {pipeline, name}

  defp locate_operator(other) do
    takes = "the stream of a join, fusion or merge, or {pipeline, its_name}"
    Argument.raise_invalid!(other, takes, "Situ.add_input(joined, :left, stream)")
  end

  defp locate_stream(_pipeline, name) when is_binary(name), do: name

  defp locate_stream(_pipeline, other) when not is_struct(other, Stream) do
    takes = "a stream, or its name, as its third argument"
    Argument.raise_invalid!(other, takes, "Situ.add_input(joined, :left, stream)")
  end

  defp locate_stream(pipeline, stream) do
    if Pipeline.Client.resolve_pid(pipeline) == stream.pipeline.pid do
      {stream.node, stream.output}
    else
      raise Error.new(
              :different_pipeline,
              "stream #{inspect(stream.name)} belongs to another pipeline",
              fix: "carry the stream over with Situ.Connector"
            )
    end
  end
end
