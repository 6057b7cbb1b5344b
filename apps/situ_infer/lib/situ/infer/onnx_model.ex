defmodule Situ.Infer.OnnxModel do
  @moduledoc """
  Runs any model in an ONNX file on streams of tensors, with named inputs and named outputs.

      depth = Situ.Infer.OnnxModel.run(pictures, "depth.onnx", output: "depth")
      out = Situ.Infer.OnnxModel.run(%{"image" => pictures, "text" => words}, "clip.onnx")

  The file is read while the pipeline is **built**. Unknown inputs, missing streams, and types and shapes that differ
  from `shapes:` are errors at that time, with both sides in the message. Several inputs are joined by equal originating
  times. An output has the time of its input. Queued messages run as one batch.

  ## Errors

  The errors of `Situ.Infer.Model`, and `:unknown_input`, `:missing_input`, `:unknown_output`.
  """

  @schema [
    shapes: [
      type: :map,
      default: %{},
      doc:
        "The types and shapes of the streams' tensors, `%{\"name\" => {type, shape}}`; `nil` is any size."
    ],
    output: [
      type: {:optional, :string},
      default: nil,
      doc: "The name of the output to emit, as tensors; `nil` emits maps of all outputs by name."
    ],
    device: [
      type: {:or, [{:in, [:cpu, :cuda]}, {:tuple, [{:in, [:cuda]}, :non_neg_integer]}]},
      default: :cpu,
      doc:
        "The device to run on. `:cuda` (or `{:cuda, 1}`) needs an ONNX Runtime with CUDA; without it there is an error."
    ],
    batch: [
      type: :pos_integer,
      default: 8,
      doc:
        "The maximum number of queued messages in one run, if the file leaves the first size free."
    ],
    model_options: [
      type: :keyword,
      default: [],
      doc: "More options for `Situ.Infer.Model.load_shared/2`: threads, sessions, warm-up ..."
    ]
  ]

  use Situ.Component,
    inputs: [in: :any],
    outputs: [out: :any],
    options: [path: [type: :string, required: true, doc: "The ONNX file."]] ++ @schema

  alias Situ.{Error, Stream, Tensor}
  alias Situ.Infer.Model

  defstruct [:opts, :model, :only]

  @doc "Runs the model on one stream of tensors, or on several by input name, and returns its output. Options as above."
  @spec run(Stream.t() | %{String.t() => Stream.t()}, Path.t(), keyword()) :: Stream.t()
  def run(streams, path, opts \\ []) do
    {own, placed} = Keyword.split(opts, Keyword.keys(@schema))
    own = Situ.Options.validate!([path: path] ++ own, options())
    model = Error.unwrap!(load_model(own))
    type = if own[:output], do: Tensor, else: :any
    streams |> join_inputs(model) |> Situ.via(__MODULE__, own ++ placed) |> Map.put(:type, type)
  end

  defp join_inputs(%Stream{} = stream, model) do
    _ = only_input!(model)
    stream
  end

  defp join_inputs(streams, model) when is_map(streams) do
    case {Map.keys(streams) -- Map.keys(model.inputs),
          Map.keys(model.inputs) -- Map.keys(streams)} do
      {[], []} -> join_streams(Enum.to_list(streams))
      {[name | _], _} -> raise unknown_port(:unknown_input, "input", name, model.inputs, model)
      {[], missing} -> raise missing_inputs(missing, model)
    end
  end

  defp join_streams([{name, first} | others]) do
    first = Situ.map(first, &%{name => &1})

    Enum.reduce(others, first, fn {name, stream}, all ->
      all
      |> Situ.join(stream, Situ.Reproducible.exact())
      |> Situ.map(fn {tensors, tensor} -> Map.put(tensors, name, tensor) end)
    end)
  end

  defp only_input!(model) do
    case Map.keys(model.inputs) do
      [name] -> name
      names -> raise missing_inputs(names, model)
    end
  end

  defp missing_inputs(names, model) do
    Error.new(
      :missing_input,
      "model #{model.name} needs a stream for #{Enum.map_join(names, ", ", &inspect/1)}",
      fix: "pass a map of streams by the names of its inputs"
    )
  end

  defp unknown_port(code, what, name, ports, model) do
    names = Map.keys(ports)
    near = Situ.Options.nearest_name(name, names)

    Error.new(code, "model #{model.name} has no #{what} #{inspect(name)}",
      why: "its #{what}s are #{Enum.map_join(names, ", ", &inspect/1)}",
      fix: if(near, do: "did you mean #{inspect(near)}?")
    )
  end

  defp load_model(opts) do
    provider = if opts[:device] == :cuda, do: {:cuda, 0}, else: opts[:device]
    settings = Keyword.merge(opts[:model_options], provider: provider, inputs: opts[:shapes])

    with {:ok, model} <- Model.load_shared(opts[:path], settings) do
      if opts[:output] == nil or is_map_key(model.outputs, opts[:output]),
        do: {:ok, model},
        else:
          {:error, unknown_port(:unknown_output, "output", opts[:output], model.outputs, model)}
    end
  end

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: Map.new(opts)}}

  @impl true
  def handle_start(_context, state) do
    model = state.opts |> Keyword.new() |> load_model() |> Error.unwrap!()
    only = if map_size(model.inputs) == 1, do: only_input!(model)
    {[], %{state | model: model, only: only}}
  end

  @impl true
  def handle_message(:in, message, context, state),
    do: handle_messages(:in, [message], context, state)

  @impl true
  def handle_messages(:in, messages, _context, state) do
    actions =
      messages
      |> Enum.chunk_every(state.opts.batch)
      |> Enum.flat_map(fn messages ->
        inputs = Enum.map(messages, &name_inputs(&1.data, state))
        outputs = Error.unwrap!(Model.run_batch(state.model, inputs))

        Enum.zip_with(
          messages,
          outputs,
          &{:out, &1.originating_time, select_output(&2, state.opts.output)}
        )
      end)

    {actions, state}
  end

  defp name_inputs(%Tensor{} = tensor, %{only: name}) when is_binary(name), do: %{name => tensor}
  defp name_inputs(%{} = tensors, _state) when not is_struct(tensors), do: tensors

  defp name_inputs(other, state) do
    raise Error.new(
            :bad_tensor,
            "model #{state.model.name} takes tensors, got: #{inspect(other, limit: 5)}"
          )
  end

  defp select_output(outputs, nil), do: outputs
  defp select_output(outputs, name), do: Map.fetch!(outputs, name)

  @impl true
  def describe(state), do: Model.describe_runs(state.model)
end
