Application.ensure_all_started(:situ_assistant)

# Only speech needs these 44 MB. `bin/lib/fetch-model` downloads them.
missing =
  for {:error, error} <- [Situ.Infer.ModelStore.fetch_path("moonshine-tiny-en", "tokenizer.bin")],
      do: error

Enum.each(missing, &IO.puts("Not tested: situ talk. " <> Exception.message(&1)))

# A busy machine may deliver an expected message late; a missing message still fails the test.
ExUnit.start(
  exclude: if(missing == [], do: [], else: [:moonshine]),
  assert_receive_timeout: 30_000,
  timeout: 120_000
)
