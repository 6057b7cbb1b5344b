defmodule Situ.Bridge.Net.KeepAlive do
  @moduledoc false
  # Notices that a peer is gone although its connection was never closed: its machine lost power, or a router between
  # them forgot the connection. A separate process sends a ping every interval, also while the owner of the connection
  # is busy, because peers disconnect silent clients. The owner checks after one and a half intervals whether any bytes
  # have arrived. A busy owner reads nothing, but checks nothing either.
  alias Situ.Bridge.Net.ClientSocket

  @enforce_keys [:tcp, :pinger, :interval_ms]
  defstruct [:tcp, :pinger, :interval_ms, heard?: true]

  @type t :: %__MODULE__{
          tcp: ClientSocket.t(),
          pinger: pid(),
          interval_ms: pos_integer(),
          heard?: boolean()
        }

  @doc "Starts to send `ping` on a connection of this process; `nil` for an interval of zero."
  @spec start_link(ClientSocket.t(), non_neg_integer(), iodata()) :: t() | nil
  def start_link(_tcp, 0, _ping), do: nil

  def start_link(tcp, interval_ms, ping) do
    pinger = spawn_link(fn -> send_pings(tcp, interval_ms, ping) end)
    schedule_check(%__MODULE__{tcp: tcp, pinger: pinger, interval_ms: interval_ms})
  end

  defp send_pings(tcp, interval_ms, ping) do
    Process.sleep(interval_ms)
    if ClientSocket.send_bytes(tcp, ping) == :ok, do: send_pings(tcp, interval_ms, ping)
  end

  @doc "Notes that the peer has sent something."
  @spec note_bytes(t() | nil) :: t() | nil
  def note_bytes(nil), do: nil
  def note_bytes(%__MODULE__{} = keep_alive), do: %{keep_alive | heard?: true}

  @doc "Handles a message of this process: `:other` unless it is a check, `:silent` if the peer has not answered."
  @spec handle_info(term(), t() | nil) :: {:ok, t()} | {:silent, String.t()} | :other
  def handle_info({__MODULE__, pinger}, %__MODULE__{pinger: pinger} = keep_alive) do
    if keep_alive.heard?,
      do: {:ok, schedule_check(%{keep_alive | heard?: false})},
      else: {:silent, "no reply for #{check_ms(keep_alive.interval_ms) / 1_000} s"}
  end

  def handle_info(_other, _keep_alive), do: :other

  defp schedule_check(%__MODULE__{} = keep_alive) do
    Process.send_after(self(), {__MODULE__, keep_alive.pinger}, check_ms(keep_alive.interval_ms))
    keep_alive
  end

  defp check_ms(interval_ms), do: div(3 * interval_ms, 2)

  @spec stop(t() | nil) :: nil
  def stop(nil), do: nil

  def stop(%__MODULE__{pinger: pinger}) do
    Process.unlink(pinger)
    Process.exit(pinger, :kill)
    nil
  end
end
