defmodule Situ.Link.Connection.Positions do
  @moduledoc false
  # Tracks the position of each stream of a link. `saved` holds the positions already written to the file.
  # `confirmed` holds the positions confirmed by the pipeline (nil before the first one), which take precedence over
  # merely delivered messages. `retained` holds the positions of streams that are no longer subscribed.
  alias Situ.Error
  alias Situ.Link.Position

  defstruct saved: %{}, confirmed: %{}, retained: %{}

  @type t :: %__MODULE__{
          saved: Position.t(),
          confirmed: %{String.t() => Situ.Time.t() | nil},
          retained: Position.t()
        }

  @doc "Makes the position of a stream its last confirmed message."
  @spec enable_confirmation(t(), String.t()) :: t()
  def enable_confirmation(%__MODULE__{} = positions, name),
    do: %{positions | confirmed: Map.put_new(positions.confirmed, name, nil)}

  @spec confirm(t(), String.t(), Situ.Time.t()) :: t()
  def confirm(%__MODULE__{} = positions, name, time),
    do: %{positions | confirmed: Map.put(positions.confirmed, name, time)}

  @doc "Keeps the final position of a stream that is no longer subscribed: messages up to `time` were consumed."
  @spec retain_position(t(), String.t(), Situ.Time.t() | nil) :: t()
  def retain_position(%__MODULE__{} = positions, _name, nil), do: positions

  def retain_position(%__MODULE__{} = positions, name, time),
    do: %{positions | retained: Map.put(positions.retained, name, time)}

  @doc "Writes changed positions to the file. `consumed` holds the positions of the subscribed streams."
  @spec save_changes(t(), Path.t(), [{String.t(), Situ.Time.t() | nil}]) ::
          {:ok | {:error, Error.t()}, t()}
  def save_changes(%__MODULE__{} = positions, path, consumed) do
    current =
      positions.retained
      |> Map.merge(reject_nil_times(consumed))
      |> Map.merge(positions.confirmed)

    updated = Map.merge(positions.saved, reject_nil_times(current))

    if updated == positions.saved,
      do: {:ok, positions},
      else: {Position.save(path, updated), %{positions | saved: updated}}
  end

  defp reject_nil_times(times),
    do: for({name, time} <- times, time != nil, into: %{}, do: {name, time})
end
