defmodule Situ.Link.Connection.Positions do
  @moduledoc false
  # Tracks the position of each stream of a link. `saved` holds the positions already written to the file.
  # `confirmed` holds the positions confirmed by the pipeline (nil before the first one), which take precedence over
  # merely delivered messages. `left` holds the positions of streams that are no longer subscribed.
  alias Situ.Error
  alias Situ.Link.Position

  defstruct saved: %{}, confirmed: %{}, left: %{}

  @type t :: %__MODULE__{
          saved: Position.t(),
          confirmed: %{String.t() => Situ.Time.t() | nil},
          left: Position.t()
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
    do: %{positions | left: Map.put(positions.left, name, time)}

  @doc "Writes changed positions to the file. `taken` holds the positions of the subscribed streams."
  @spec save_changes(t(), Path.t(), [{String.t(), Situ.Time.t() | nil}]) ::
          {:ok | {:error, Error.t()}, t()}
  def save_changes(%__MODULE__{} = positions, path, taken) do
    known = positions.left |> Map.merge(reject_nil_times(taken)) |> Map.merge(positions.confirmed)
    now = Map.merge(positions.saved, reject_nil_times(known))

    if now == positions.saved,
      do: {:ok, positions},
      else: {Position.save(path, now), %{positions | saved: now}}
  end

  defp reject_nil_times(times),
    do: for({name, time} <- times, time != nil, into: %{}, do: {name, time})
end
