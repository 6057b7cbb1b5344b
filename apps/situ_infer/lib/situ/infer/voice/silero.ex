defmodule Situ.Infer.Voice.Silero do
  @moduledoc false
  # Silero's network over chunks of 512 samples. Its memory is a state tensor, and it also needs the last 64 samples of
  # the previous chunk; both are kept in this state.
  @behaviour Situ.Infer.Voice.Detector

  alias Situ.Infer.{BundledModel, Model}
  alias Situ.Tensor

  @chunk 512
  @context 64
  @ports [
    inputs: %{
      "input" => {:f32, {nil, @chunk + @context}},
      "state" => {:f32, {2, nil, 128}},
      "sr" => {:s64, {}}
    },
    outputs: %{"output" => {:f32, {nil, 1}}}
  ]

  # The network has a branch per sample rate, so the warm-up must take the branch that will be used.
  @rate Macro.escape(Tensor.from_list([16_000], :s64, {}))

  @enforce_keys [:model]
  defstruct [:model, :state, :context]

  def chunk_samples, do: @chunk

  @impl true
  @spec load(keyword()) :: {:ok, %__MODULE__{}} | {:error, Situ.Error.t()}
  def load(opts) do
    settings = [{:example, %{"sr" => unquote(@rate)}} | @ports]

    with {:ok, model} <- BundledModel.load(opts, "silero_vad.onnx", settings),
         do: {:ok, reset(%__MODULE__{model: model})}
  end

  @impl true
  def reset(silero) do
    %{silero | state: Tensor.zeros(:f32, {2, 1, 128}), context: <<0::size(@context)-unit(32)>>}
  end

  @impl true
  def step(silero, <<_::binary-size((@chunk - @context) * 4), context::binary>> = chunk, _level) do
    inputs = %{
      "input" => Tensor.new(silero.context <> chunk, :f32, {1, @chunk + @context}),
      "state" => silero.state,
      "sr" => unquote(@rate)
    }

    with {:ok, outputs} <- Model.run(silero.model, inputs) do
      %{"output" => %{data: <<p::float-native-32>>}, "stateN" => state} = outputs
      {:ok, p, %{silero | state: state, context: context}}
    end
  end
end
