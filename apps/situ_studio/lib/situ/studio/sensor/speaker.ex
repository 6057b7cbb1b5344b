defmodule Situ.Studio.Sensor.Speaker do
  @moduledoc """
  Plays audio in the page of a sensor (`Situ.Studio.Sensor`).

      Situ.Studio.Sensor.Speaker.play(assistant.sound, page: "phone")

  Audio is played when it arrives. It is lost if no page is connected, or if the page does not read its messages.
  """
  use Situ.Component,
    inputs: [in: Situ.AudioBuffer],
    options: [page: [type: :string, default: "page", doc: "The sensor's name."]]

  alias Situ.AudioOps
  alias Situ.Studio.Sensor

  # A page that reads its messages never has this many in its mailbox.
  @most 100

  @doc "Connects the speaker to `stream`; returns `stream`."
  @spec play(Situ.Stream.t(), keyword()) :: Situ.Stream.t()
  def play(stream, opts \\ []) do
    Situ.via(stream, __MODULE__, opts)
    stream
  end

  @impl true
  def init(opts), do: {:ok, opts[:page]}

  @impl true
  def handle_message(:in, %{data: buffer}, _context, name) do
    with {:ok, pid} <- Sensor.Inbox.fetch_page(Sensor, name),
         {:message_queue_len, waiting} when waiting < @most <-
           Process.info(pid, :message_queue_len) do
      mono = AudioOps.reformat!(buffer, channels: 1, sample: :s16)
      send(pid, {:play, mono.format.rate, mono.data})
    end

    {[], name}
  end
end
