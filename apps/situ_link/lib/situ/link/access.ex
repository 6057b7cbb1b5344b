defmodule Situ.Link.Access do
  @moduledoc false
  # Resolves the token and the TLS options of a link when the caller has only an address: on a
  # command line, in the studio, or in a dataset.
  #
  # The token comes from the first of these sources that has one: the option `token:`, `config
  # :situ_link, tokens: %{"lab1" => "..."}` (by the host of the address), the environment variable
  # `SITU_TOKEN`, and the first line of the file named by `SITU_TOKEN_FILE`. The TLS options come
  # from `tls:`.
  alias Situ.{Error, Options}
  alias Situ.Link.Address

  @schema [
    token: [type: :string, doc: "The secret shared by both sides."],
    tls: [type: :keyword, default: [], doc: "Options of `:ssl` for `situs://`."]
  ]

  @type t :: %{token: Situ.Link.Wire.Handshake.token(), tls: keyword()}

  @doc """
  Returns the token and the TLS options for `address`.

  Errors: invalid options, and `:no_token` if the token file cannot be read.

      iex> {:ok, address} = Situ.Link.Address.parse("situ://lab1/lobby")
      iex> Situ.Link.Access.new(address, token: "secret")
      {:ok, %{token: "secret", tls: []}}
  """
  @spec new(Address.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def new(%Address{} = address, opts) do
    with {:ok, opts} <- Options.validate(opts, @schema),
         {:ok, token} <- resolve_token(opts[:token], address),
         do: {:ok, %{token: token, tls: opts[:tls]}}
  end

  defp resolve_token(token, _address) when is_binary(token), do: {:ok, token}

  defp resolve_token(nil, address) do
    configured = Application.get_env(:situ_link, :tokens, %{})

    case {configured[address.host] || read_env("SITU_TOKEN"), read_env("SITU_TOKEN_FILE")} do
      {token, _} when is_binary(token) -> {:ok, token}
      {nil, nil} -> {:ok, ""}
      {nil, file} -> read_token_file(file)
    end
  end

  defp read_env(name) do
    with "" <- System.get_env(name), do: nil
  end

  @doc "Reads a token from the first line of a file."
  @spec read_token_file(Path.t()) :: {:ok, String.t()} | {:error, Error.t()}
  def read_token_file(file) do
    with {:ok, text} <- File.read(file),
         [token | _] when token != "" <- String.split(text, ["\r\n", "\n"]) do
      {:ok, token}
    else
      {:error, reason} ->
        {:error,
         Error.new(:no_token, "cannot read #{file}", why: to_string(:file.format_error(reason)))}

      _ ->
        {:error,
         Error.new(:no_token, "the first line of #{file} is empty",
           fix: "write the token into the first line"
         )}
    end
  end
end
