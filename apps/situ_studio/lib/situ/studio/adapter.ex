defmodule Situ.Studio.Adapter do
  @moduledoc """
  Converts the messages of a stream into data of another shape. The stream can then be drawn by every visualizer that
  accepts that shape.

      defmodule Loudness do
        @behaviour Situ.Studio.Adapter

        @impl true
        def about, do: %Situ.Studio.Adapter{id: "loudness", title: "Loudness", from: [:audio], to: :signal}

        @impl true
        def adapt(%Situ.AudioBuffer{} = buffer, _message) do
          samples = Situ.AudioBuffer.to_samples(buffer)
          {:ok, Enum.sum(Enum.map(samples, &abs/1)) / max(length(samples), 1)}
        end

        def adapt(_data, _message), do: :error
      end

      Situ.Studio.start_link(adapters: [Loudness])

  The stream's menu then contains "Line (Loudness)". `Situ.Studio.Visualizer` lists the shapes. An adapter must be
  stateless: only displayed messages are adapted, in any order.
  """
  alias Situ.Studio.{StreamInfo, Visualizer}

  @enforce_keys [:id, :title, :from, :to]
  defstruct [:id, :title, :from, :to]

  @type t :: %__MODULE__{
          id: String.t(),
          title: String.t(),
          from: [StreamInfo.shape()] | :any,
          to: StreamInfo.shape()
        }

  @doc "Returns the adapter's description: the shapes that it accepts, and the shape that it produces."
  @callback about() :: t()

  @doc "Returns the adapted data of a message, or `:error` if the message cannot be converted."
  @callback adapt(data :: term(), Situ.Message.t()) :: {:ok, term()} | :error

  @doc """
  Returns copies of the visualizers that accept the adapter's output; their names include the adapter's title.

      iex> defmodule Doubled do
      ...>   def about, do: %Situ.Studio.Adapter{id: "doubled", title: "Doubled", from: [:text], to: :boolean}
      ...> end
      iex> line = %Situ.Studio.Visualizer{id: "line", title: "Line", panel: :plot, shapes: [:signal, :boolean]}
      iex> for v <- Situ.Studio.Adapter.adapted_visualizers(Doubled, [line]), do: {v.id, v.title, v.shapes}
      [{"line@doubled", "Line (Doubled)", [:text]}]
  """
  @spec adapted_visualizers(module(), [Visualizer.t()]) :: [Visualizer.t()]
  def adapted_visualizers(module, visualizers) do
    %{id: id, title: title, from: from, to: to} = module.about()

    for %{shapes: shapes} = v <- visualizers, shapes != :any, to in shapes, v.adapter == nil do
      %{v | id: "#{v.id}@#{id}", title: "#{v.title} (#{title})", shapes: from, adapter: module}
    end
  end
end
