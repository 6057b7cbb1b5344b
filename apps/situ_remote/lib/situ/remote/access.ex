defmodule Situ.Remote.Access do
  @moduledoc """
  How to get in where an address alone is given: on a command line, in the studio, in a dataset.

  In this order: what the caller says (`token:`, `tls:`), `config :situ_remote, tokens: %{"lab1" => "..."}` by the
  address's host, the environment variable `SITU_TOKEN`, and the first line of the file that `SITU_TOKEN_FILE` names.

      iex> {:ok, address} = Situ.Remote.Address.parse("situ://lab1/lobby")
      iex> Situ.Remote.Access.new(address, token: "secret")
      {:ok, %{token: "secret", tls: []}}
  """
  alias Situ.{Error, Options}
  alias Situ.Remote.Address

  @schema [
    token: [type: :string, doc: "The secret that both sides share."],
    tls: [type: :keyword, default: [], doc: "Options of `:ssl` for `situs://`."]
  ]

  @type t :: %{token: Situ.Remote.Link.Handshake.token(), tls: keyword()}

  @doc "Errors: those of options, `:no_token` for a file that cannot be read."
  @spec new(Address.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def new(%Address{} = address, opts) do
    with {:ok, opts} <- Options.validate(opts, @schema),
         {:ok, token} <- token(opts[:token], address),
         do: {:ok, %{token: token, tls: opts[:tls]}}
  end

  defp token(token, _address) when is_binary(token), do: {:ok, token}

  defp token(nil, address) do
    configured = Application.get_env(:situ_remote, :tokens, %{})

    case {configured[address.host] || env("SITU_TOKEN"), env("SITU_TOKEN_FILE")} do
      {token, _} when is_binary(token) -> {:ok, token}
      {nil, nil} -> {:ok, ""}
      {nil, file} -> first_line(file)
    end
  end

  defp env(name) do
    with "" <- System.get_env(name), do: nil
  end

  @doc "The token in a file: its first line."
  @spec first_line(Path.t()) :: {:ok, String.t()} | {:error, Error.t()}
  def first_line(file) do
    with {:ok, text} <- File.read(file),
         [token | _] when token != "" <- String.split(text, ["\r\n", "\n"]) do
      {:ok, token}
    else
      {:error, reason} ->
        {:error,
         Error.new(:no_token, "cannot read #{file}", why: to_string(:file.format_error(reason)))}

      _ ->
        {:error,
         Error.new(:no_token, "#{file} begins with an empty line",
           fix: "write the token into its first line"
         )}
    end
  end
end
