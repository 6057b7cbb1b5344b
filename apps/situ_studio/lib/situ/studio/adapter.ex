defmodule Situ.Studio.Adapter do
  @moduledoc """
  Makes of the messages of a stream something that a visualizer takes: a stream of one shape is then offered
  everything that draws the other.

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

  The stream's menu then has "Line (Loudness)". An adapter must not keep state: messages are adapted in any order, those
  that are looked at only.
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

  @doc "The adapter's description: the shapes that it takes, and the one that it makes."
  @callback about() :: t()

  @doc "The new data of a message; `:error` if this message has none."
  @callback adapt(data :: term(), Situ.Message.t()) :: {:ok, term()} | :error

  @doc """
  The visualizers that an adapter opens: all that take what it makes, named after both.

      iex> defmodule Doubled do
      ...>   def about, do: %Situ.Studio.Adapter{id: "doubled", title: "Doubled", from: [:text], to: :boolean}
      ...> end
      iex> visualizers = Situ.Studio.Visualizers.all()
      iex> for v <- Situ.Studio.Adapter.visualizers(Doubled, visualizers), do: {v.id, v.title, v.shapes}
      [{"states@doubled", "States (Doubled)", [:text]}, {"line@doubled", "Line (Doubled)", [:text]}]
  """
  @spec visualizers(module(), [Visualizer.t()]) :: [Visualizer.t()]
  def visualizers(module, visualizers) do
    %{id: id, title: title, from: from, to: to} = module.about()

    for %{shapes: shapes} = v <- visualizers, shapes != :any, to in shapes, v.adapter == nil do
      %{v | id: "#{v.id}@#{id}", title: "#{v.title} (#{title})", shapes: from, adapter: module}
    end
  end
end
