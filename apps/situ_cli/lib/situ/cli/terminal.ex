defmodule Situ.CLI.Terminal do
  @moduledoc false
  # Writes status lines to the terminal that standard error is connected to.
  #
  # Without a shell the VM does not know its terminal, but the system does. The terminal is opened again, because raw
  # writes reach it before the next line of standard output.

  @type t :: :file.fd()

  @doc "Opens the terminal; returns `nil` if standard error is not connected to one, or if the options forbid it."
  @spec open(keyword()) :: t() | nil
  def open(opts) do
    with false <- Keyword.get(opts, :quiet, false) or Keyword.get(opts, :json, false),
         {:ok, device} <- File.read_link("/proc/self/fd/2"),
         true <- device =~ ~r{\A/dev/(pts/|tty|console)},
         {:ok, device} <- :file.open(device, [:write, :raw, :binary]) do
      device
    else
      _ -> nil
    end
  end

  @doc "Replaces the current line by `text`."
  @spec replace_line(t() | nil, String.t()) :: :ok
  def replace_line(nil, _text), do: :ok

  def replace_line(terminal, text) do
    _ = :file.write(terminal, "\r\e[K" <> text)
    :ok
  end

  @doc "Clears the current line and closes the terminal."
  @spec close(t() | nil) :: :ok
  def close(nil), do: :ok

  def close(terminal) do
    replace_line(terminal, "")
    _ = :file.close(terminal)
    :ok
  end
end
