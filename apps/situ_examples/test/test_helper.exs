Application.ensure_all_started(:situ_examples)
ExUnit.start()
