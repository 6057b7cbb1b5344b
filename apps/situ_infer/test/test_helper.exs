Application.ensure_all_started(:situ_infer)

# Only some programs need these models; bin/lib/fetch-model fetches them.
models = [
  {:moonshine, "speech recognition", "moonshine-tiny-en", "tokenizer.bin"},
  {:hibari, "the natural voice", "hibari", "hibari.onnx"},
  {:ocr, "text in pictures", "pp-ocr-v4", "ch_PP-OCRv4_rec_infer.onnx"}
]

missing =
  for {tag, what, name, file} <- models,
      {:error, error} <- [Situ.Infer.ModelStore.fetch_path(name, file)] do
    IO.puts("Not tested: #{what}. " <> Exception.message(error))
    tag
  end

# A busy machine may deliver an expected message late; a missing message still fails the test.
ExUnit.start(
  exclude: missing,
  assert_receive_timeout: 30_000,
  timeout: 120_000
)
