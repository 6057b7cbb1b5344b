defmodule Situ.Live.Token do
  @moduledoc false
  # Signs values that a browser stores for the server, so that the browser cannot change them.
  #
  # A token is `BODY.MAC`: base64url of the JSON `[salt, issued_at_seconds, value]`, and its
  # HMAC-SHA256. It is not encrypted.
  alias Situ.JSON

  @doc """
  Signs a JSON-able value for one purpose (`salt`).

      iex> token = Situ.Live.Token.sign("a secret of 32 bytes or more ....", "session", %{"id" => 1})
      iex> Situ.Live.Token.verify("a secret of 32 bytes or more ....", "session", token, 60)
      {:ok, %{"id" => 1}}
      iex> Situ.Live.Token.verify("another secret", "session", token, 60)
      {:error, :bad_token}
  """
  @spec sign(binary(), String.t(), term(), integer()) :: String.t()
  def sign(secret, salt, value, now_s \\ System.system_time(:second)) do
    body = Base.url_encode64(JSON.encode([salt, now_s, value]), padding: false)
    body <> "." <> compute_mac(secret, body)
  end

  @doc "Returns the value if the signature is valid, the salt is the same and the age is at most `max_age_s`."
  @spec verify(binary(), String.t(), term(), pos_integer(), integer()) ::
          {:ok, term()} | {:error, :bad_token | :expired}
  def verify(secret, salt, token, max_age_s, now_s \\ System.system_time(:second))

  def verify(secret, salt, token, max_age_s, now_s) when is_binary(token) do
    with [body, mac] <- :binary.split(token, "."),
         expected = compute_mac(secret, body),
         true <- byte_size(mac) == byte_size(expected) and :crypto.hash_equals(mac, expected),
         {:ok, json} <- Base.url_decode64(body, padding: false),
         {:ok, [^salt, issued_s, value]} when is_integer(issued_s) <- JSON.decode(json) do
      if now_s - issued_s <= max_age_s, do: {:ok, value}, else: {:error, :expired}
    else
      _ -> {:error, :bad_token}
    end
  end

  def verify(_, _, _, _, _), do: {:error, :bad_token}

  defp compute_mac(secret, body) do
    :hmac |> :crypto.mac(:sha256, secret, body) |> Base.url_encode64(padding: false)
  end
end
